"""Pages as they are written, with their links led to where the site has what they name."""

import os
import re
import shutil
from pathlib import Path

ROOT = Path(__file__).parents[2]
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?!https?:|#)([^)#\s]+)(#[^)\s]*)?\)")
_FENCES = re.compile(r"(^```.*?^```$)", re.MULTILINE | re.DOTALL)


def written() -> dict[str, str]:
    """The site's path of each page in the repository, by its path there."""
    pages = {
        "README.md": "index.md",
        "CHANGELOG.md": "changes.md",
        "CONTRIBUTING.md": "contributing.md",
        "benchmarks/RESULTS.md": "benchmarks/results.md",
    }
    folder = ROOT / "docs"
    names = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.md"))
    return pages | {f"docs/{name}": name for name in names}


def generated() -> dict[str, str]:
    """The site's path of the page that is generated from a file of the repository."""
    names = sorted(path.stem for path in (ROOT / "notebooks").glob("*.ipynb"))
    return {
        "mishutter/model/scene_schema.py": "reference/scene.md",
        "mishutter/example_scene.toml": "reference/scene.md",
        "mishutter/cli/app.py": "reference/commands.md",
        "mishutter/__init__.py": "reference/index.md",
        "mishutter/torch.py": "reference/torch.md",
        "benchmarks/scenes.py": "gallery.md",
        "CITATION.cff": "citing.md",
    } | {f"notebooks/{name}.ipynb": f"notebooks/{name}.md" for name in names}


def write_pages(folder: Path) -> None:
    """Copy every page that is written, and the files that they link to, into a folder.

    Raises:
        FileNotFoundError: if a page links to what is not there.
    """
    for source, place in written().items():
        target = folder / place
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(with_links((ROOT / source).read_text("utf-8"), source, folder))


def with_links(text: str, source: str, folder: Path) -> str:
    """Text of a file of the repository, whose links count from its page's place on the site.

    Args:
        text: Markdown.
        source: The file.
        folder: The site's pages, beside which files are copied that it links to.

    Raises:
        FileNotFoundError: if it links to what is not there.
    """
    places = written() | generated()
    place = places[source]

    def relinked(link: re.Match[str]) -> str:
        mark, text, path, anchor = link.groups()
        name = os.path.relpath((ROOT / source).parent / path, ROOT)
        if name in places:
            aim = places[name]
        elif (ROOT / name).is_dir():
            return text
        else:
            aim = f"files/{name}"
            (folder / aim).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / aim)
        return f"{mark}[{text}]({os.path.relpath(aim, Path(place).parent)}{anchor or ''})"

    parts = _FENCES.split(text)
    return "".join(part if part.startswith("```") else _LINK.sub(relinked, part) for part in parts)
