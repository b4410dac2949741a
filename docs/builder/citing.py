"""The page that says how to cite the package, from `CITATION.cff`."""

import yaml

from docs.builder.pages import ROOT


def citing_page() -> str:
    """The package and the works that it builds on, and the file that programs read."""
    text = (ROOT / "CITATION.cff").read_text("utf-8")
    cited = yaml.safe_load(text)
    lines = [
        f"# How to cite\n\n{cited['message']}\n",
        f"- {_sentence(cited)}, version {cited['version']}.",
    ]
    lines += [f"- {_sentence(work)}." for work in cited["references"]]
    return (
        "\n".join(lines)
        + f"\n\nThe same for programs, in `CITATION.cff`:\n\n```yaml\n{text.rstrip()}\n```\n"
    )


def _sentence(work: dict) -> str:
    names = [a.get("name") or f"{a['given-names']} {a['family-names']}" for a in work["authors"]]
    place = f". {work['journal']} {work['volume']}({work['issue']})" if "journal" in work else ""
    year = f", {work['year']}" if "year" in work else ""
    return f"{', '.join(names)}. *{work['title']}*{place}{year}"
