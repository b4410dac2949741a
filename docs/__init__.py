"""Pages for people, and `python -m docs`, which builds the site from them."""
