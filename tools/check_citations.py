#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that every citation in the sources and documents names an entry of docs/references.bib.

A citation is `[Author Year]` or `[Author Year, where]`, for example `[Manzi 2016, Eq. 3]`; several may share one pair of
brackets, separated by semicolons or commas. The bibliography's key for it is the author in lower case followed by the year
(`manzi2016`), with any title word after it (`manzi2016temporal`). A year letter tells two papers of one year apart
(`[Heitz 2018b]`, `heitz2018b`).

A citation stands on one line, so that a search finds it.

Exit status: 0 all found, 1 otherwise; each fault is printed as file:line.
"""
import re
import subprocess
import sys
import unicodedata
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BIBLIOGRAPHY = ROOT / "docs" / "references.bib"
SUFFIXES = {".h", ".cpp", ".cu", ".py", ".md", ".cmake", ".txt"}

ONE = r"[^\W\d_][\w'’-]*(?: (?:and|&) [^\W\d_][\w'’-]*| et al\.)? (?:1[89]|20)\d\d[a-z]?(?:, [^\][;]+)?"
CITATION = re.compile(r"\[(" + ONE + r"(?:[;,] " + ONE + r")*)\](?!\()")
BROKEN = re.compile(r"\[" + ONE.replace("(?:, [^\\][;]+)?", "") + r"(?:,[^\][;]*)?$")
SEPARATOR = re.compile(r"[;,] (?=" + ONE + r")")
PART = re.compile(r"^(?P<author>[^\W\d_][\w'’-]*).*? (?P<year>(?:1[89]|20)\d\d[a-z]?)(?:, |$)")


def plain(name: str) -> str:
    """Lower case, without accents, apostrophes and hyphens: as in a key."""
    decomposed = unicodedata.normalize("NFKD", name.lower())
    return "".join(c for c in decomposed if c.isalnum() and not unicodedata.combining(c))


def citations(text: str):
    """Yields (line number, citation, key prefix) of each citation in `text`."""
    for number, line in enumerate(text.splitlines(), 1):
        for group in CITATION.finditer(line):
            for part in SEPARATOR.split(group.group(1)):
                match = PART.match(part)
                if match:
                    yield number, part, plain(match["author"]) + match["year"]


def broken_citations(text: str):
    """Yields (line number, its end) where a line ends within a citation."""
    for number, line in enumerate(text.splitlines(), 1):
        if found := BROKEN.search(line.rstrip()):
            yield number, found.group()


def main() -> int:
    keys = []
    if BIBLIOGRAPHY.exists():
        keys = re.findall(r"^\s*@\w+\s*\{\s*([^,\s]+)", BIBLIOGRAPHY.read_text(encoding="utf-8"), re.M)
    faults = [f"{BIBLIOGRAPHY.relative_to(ROOT)}: key {key} is there twice"
              for key in sorted({k for k in keys if keys.count(k) > 1})]
    lowered = [key.lower() for key in keys]
    listing = subprocess.run(["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"], cwd=ROOT,
                             capture_output=True, check=True).stdout.decode()
    count = 0
    for name in filter(None, listing.split("\0")):
        path = ROOT / name
        if path.suffix not in SUFFIXES or path == Path(__file__).resolve() or not path.is_file():
            continue
        for line, end in broken_citations(path.read_text(encoding="utf-8", errors="replace")):
            faults.append(f"{name}:{line}: the citation {end} is broken over two lines")
        for line, citation, key in citations(path.read_text(encoding="utf-8", errors="replace")):
            count += 1
            # What follows author and year in a key is a word of the title; a letter of the year is not one by itself.
            if not any(k == key or (k.startswith(key) and len(k) > len(key) + 1 and k[len(key)].isalpha())
                       for k in lowered):
                faults.append(f"{name}:{line}: [{citation}] has no entry {key} in docs/references.bib")
    for fault in faults:
        print(fault, file=sys.stderr)
    print(f"citations: {count} checked against {len(keys)} references, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
