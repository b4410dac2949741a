"""The build, from a checkout to a checked site."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor

from docs.builder.links import broken_links
from docs.builder.notebooks import FOLDER, write_notebook
from docs.builder.pages import ROOT, write_pages

PAGES = ROOT / "build" / "pages"
SITE = ROOT / "site"
_PICTURE = re.compile(r"^!\[[^\]]*\]\(([^)\s]+)\)$", re.MULTILINE)
"""A picture that stands alone."""
_QUICK = {
    "MPLBACKEND": "agg",
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "TF_CPP_MIN_LOG_LEVEL": "3",
}
"""Settings of the build where the user chose no others."""


def build() -> None:
    """Write all pages, make the site of them and check its links.

    Raises:
        SystemExit: with 1 if a page or a link is wrong.
    """
    for name, value in _QUICK.items():
        os.environ.setdefault(name, value)
    begin = time.perf_counter()
    shutil.rmtree(PAGES, ignore_errors=True)
    write_pages(PAGES)
    shutil.copy(ROOT / "docs" / "style.css", PAGES)
    with tempfile.TemporaryDirectory(prefix="mishutter-site-") as programs:
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", programs)  # of all kernels and the rest
        with ThreadPoolExecutor(2) as pool:
            names = sorted(path.name for path in FOLDER.glob("*.ipynb"))
            runs = [pool.submit(write_notebook, name, PAGES) for name in names]
            _write_generated()
            for run in runs:
                run.result()
    print(f"pages written after {time.perf_counter() - begin:.0f} s", flush=True)
    for page in PAGES.rglob("*.md"):
        page.write_text(as_shown(page.read_text("utf-8")))
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
    if subprocess.run(command, cwd=ROOT, check=False).returncode:
        raise SystemExit("mishutter: the site was not built: see above")
    broken = broken_links(SITE)
    if broken:
        raise SystemExit(
            "\n".join(["mishutter: the site's links must hold; these do not:", *broken])
        )
    print(f"{SITE} built in {time.perf_counter() - begin:.0f} s", flush=True)


def as_shown(text: str) -> str:
    """A page with pictures that lead to themselves at full size."""
    return _PICTURE.sub(r"[\g<0>](\1)", text)


def _write_generated() -> None:
    import jax

    jax.config.update("jax_enable_x64", True)

    from docs.builder.citing import citing_page
    from docs.builder.gallery import write_gallery
    from docs.builder.reference import write_reference

    (PAGES / "citing.md").write_text(citing_page())
    write_reference(PAGES)
    write_gallery(PAGES)
