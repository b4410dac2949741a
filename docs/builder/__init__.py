"""What makes the site: pages as they are written, generated ones, and a check of all links."""

from docs.builder.site import build as build
