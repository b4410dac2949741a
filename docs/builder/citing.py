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
    entries = [_entry("mishutter", cited), *(_entry(_key(w), w) for w in cited["references"])]
    return (
        "\n".join(lines)
        + "\n\n## BibTeX\n\n```bibtex\n"
        + "\n\n".join(entries)
        + f"\n```\n\nThe same for programs, in `CITATION.cff`:\n\n```yaml\n{text.rstrip()}\n```\n"
    )


def _key(work: dict) -> str:
    first = work["authors"][0]
    name = first.get("family-names", first.get("name"))
    return f"{name.lower()}{work.get('year', '')}"


def _entry(key: str, work: dict) -> str:
    """The entry of a work in BibTeX; a field that is not known is left out."""
    year = work.get("year") or str(work.get("date-released", ""))[:4]
    names = [
        f"{a['family-names']}, {a['given-names']}" if "given-names" in a else f"{{{a['name']}}}"
        for a in work["authors"]
    ]
    fields = {
        "author": " and ".join(names),
        "title": f"{{{work['title']}}}",
        "journal": work.get("journal"),
        "volume": work.get("volume"),
        "number": work.get("issue"),
        "year": year,
        "version": work.get("version"),
        "doi": work.get("doi"),
        "note": work.get("notes"),
    }
    lines = (f"  {name} = {{{value}}}," for name, value in fields.items() if value)
    kind = "article" if work["type"] == "article" else "misc"
    return "\n".join([f"@{kind}{{{key},", *lines, "}"])


def _sentence(work: dict) -> str:
    names = [a.get("name") or f"{a['given-names']} {a['family-names']}" for a in work["authors"]]
    place = f". {work['journal']} {work['volume']}({work['issue']})" if "journal" in work else ""
    year = f", {work['year']}" if "year" in work else ""
    return f"{', '.join(names)}. *{work['title']}*{place}{year}"
