#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Draws which module uses which, as CMake declares it, to docs/images/modules.svg.

What a module uses through another one is left out. With --check nothing is written. Checked either way: no circle among
the modules; that each includes what it is drawn to use, and nothing else; the order of the table in
docs/architecture.md. With --check the picture must also be what would be drawn.
Exit status: 0 right, 1 otherwise; each fault is printed.
"""
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PICTURE = ROOT / "docs/images/modules.svg"
PROGRAM = "program"  # apps/tempera, above all modules

BOX, HEIGHT, ROW, MARGIN = 116, 34, 78, 8  # pixels
GAP = 26


def declared() -> dict[str, list[str]]:
    """What each module uses."""
    uses = {}
    for file in sorted(ROOT.glob("libs/*/CMakeLists.txt")):
        call = re.search(r"tempera_module\(\s*(\w+)([^)]*)\)", file.read_text())
        if not call or call[1] != file.parent.name:
            raise SystemExit(f"{file.relative_to(ROOT)}: no tempera_module({file.parent.name} ...)")
        words = call[2].split()
        begin = words.index("DEPENDS") + 1 if "DEPENDS" in words else len(words)
        depends = []
        for word in words[begin:]:
            if word.isupper():  # the next keyword
                break
            depends.append(word)
        uses[call[1]] = depends
    program = (ROOT / "apps/tempera/CMakeLists.txt").read_text()
    uses[PROGRAM] = re.findall(r"tempera::(\w+)", program)
    return uses


def included(module: str) -> set[str]:
    """Modules that files of `module` include, but for its tests."""
    folder = ROOT / "apps/tempera" if module == PROGRAM else ROOT / "libs" / module
    found = set()
    for file in [*folder.rglob("*.h"), *folder.rglob("*.cpp"), *folder.rglob("*.cu")]:
        if "tests" in file.relative_to(folder).parts:
            continue
        found |= set(re.findall(r'^#include "tempera/(\w+)/', file.read_text(), re.MULTILINE))
    return found - {module}


def find_circle(uses: dict[str, list[str]]) -> list[str]:
    """Modules that use each other in a ring; empty if none do."""
    done: set[str] = set()

    def walk(module: str, path: list[str]) -> list[str]:
        if module in path:
            return [*path[path.index(module):], module]
        if module in done:
            return []
        for other in uses.get(module, []):
            if circle := walk(other, [*path, module]):
                return circle
        done.add(module)
        return []

    for module in uses:
        if circle := walk(module, []):
            return circle
    return []


def reachable(uses: dict[str, list[str]], module: str) -> set[str]:
    found: set[str] = set()
    for other in uses[module]:
        found |= {other} | reachable(uses, other)
    return found


def direct(uses: dict[str, list[str]]) -> dict[str, list[str]]:
    """Without what follows from the rest: what a module uses through another one."""
    return {m: [o for o in others if not any(o in reachable(uses, b) for b in others if b != o)]
            for m, others in uses.items()}


def check(uses: dict[str, list[str]]) -> list[str]:
    if circle := find_circle(uses):
        return ["modules use each other in a circle: " + " -> ".join(circle)]
    faults = []
    for module in uses:
        known = reachable(uses, module)
        faults += [f"{module} includes {o}, which it does not declare" for o in sorted(included(module) - known)]
    for module, others in direct(uses).items():
        faults += [f"{module} declares {o}, which it does not include" for o in sorted(set(others) - included(module))]
    table = re.findall(r"^\| `(\w+)` \|", (ROOT / "docs/architecture.md").read_text(), re.MULTILINE)
    rows = [row for row in table if row in uses]
    if sorted(rows) != sorted(set(uses) - {PROGRAM}):
        faults.append("the table of docs/architecture.md does not have each module once")
    for module in rows:
        faults += [f"docs/architecture.md has {module} above {o}, which it uses" for o in uses[module]
                   if o in rows and rows.index(o) > rows.index(module)]
    return faults


def layout(edges: dict[str, list[str]]) -> tuple[list[list[str]], list[list[str]]]:
    """Rows from top to bottom, and the chain of places that each edge goes through: long ones pass between the boxes
    of the rows that they cross, at places of their own ("from>to")."""
    depth: dict[str, int] = {}

    def level(module: str) -> int:  # 0 at the bottom
        if module not in depth:
            depth[module] = 1 + max((level(o) for o in edges[module]), default=-1)
        return depth[module]

    top = max(level(m) for m in edges)
    rows: list[list[str]] = [[] for _ in range(top + 1)]
    for module in edges:
        rows[top - depth[module]].append(module)
    chains = []
    for module, others in edges.items():
        for other in others:
            chain = [module]
            for row in range(top - depth[module] + 1, top - depth[other]):
                place = f"{module}>{other}@{row}"
                rows[row].append(place)
                chain.append(place)
            chains.append([*chain, other])
    # Each place moves towards the mean of its neighbours, down and up again.
    order = {p: i for row in rows for i, p in enumerate(row)}
    steps = [(a, b) for chain in chains for a, b in zip(chain, chain[1:])]
    for sweep in range(24):
        down = sweep % 2 == 0
        for row in rows if down else reversed(rows):
            def mean(place: str) -> float:
                near = [order[a] for a, b in steps if b == place] if down else [order[b] for a, b in steps if a == place]
                return sum(near) / len(near) if near else order[place]
            row.sort(key=lambda p: (mean(p), p))
            shift = -(len(row) - 1) / 2
            order.update({p: shift + i for i, p in enumerate(row)})
    return rows, chains


def draw(uses: dict[str, list[str]]) -> str:
    rows, chains = layout(direct(uses))
    is_box = {p: p in uses for row in rows for p in row}
    width_of = lambda row: sum((BOX if is_box[p] else 12) for p in row) + GAP * (len(row) - 1)
    width = max(map(width_of, rows)) + 2 * MARGIN
    height = (len(rows) - 1) * ROW + HEIGHT + 2 * MARGIN
    at: dict[str, tuple[float, float]] = {}  # middle of the upper side
    for i, row in enumerate(rows):
        x = (width - width_of(row)) / 2
        for place in row:
            w = BOX if is_box[place] else 12
            at[place] = (x + w / 2, MARGIN + i * ROW)
            x += w + GAP
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
           'font-family="sans-serif" font-size="14" role="img">',
           "<title>Modules, and which of them use which</title>",
           '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
           '<path d="M0 0.5L7.5 4L0 7.5z" fill="#7d8896"/></marker></defs>']
    for chain in chains:
        x, y = at[chain[0]]
        path = f"M{x:g} {y + HEIGHT:g}"
        y += HEIGHT
        for place in chain[1:]:
            to_x, to_y = at[place]
            bend = (to_y - y) / 2
            path += f"C{x:g} {y + bend:g} {to_x:g} {to_y - bend:g} {to_x:g} {to_y:g}"
            x, y = to_x, to_y
            if not is_box[place]:
                y += HEIGHT
                path += f"V{y:g}"
        out.append(f'<path d="{path}" fill="none" stroke="#7d8896" stroke-width="1.4" marker-end="url(#tip)"/>')
    for place, (x, y) in sorted(at.items()):
        if not is_box[place]:
            continue
        fill = "#f6e3c5" if place == PROGRAM else "#dfe9f5"
        name = "apps/tempera" if place == PROGRAM else place
        out.append(f'<rect x="{x - BOX / 2:g}" y="{y:g}" width="{BOX}" height="{HEIGHT}" rx="5" fill="{fill}" '
                   'stroke="#7d8896"/>')
        out.append(f'<text x="{x:g}" y="{y + HEIGHT / 2 + 5:g}" text-anchor="middle" fill="#1b2430">{name}</text>')
    return "\n".join([*out, "</svg>"]) + "\n"


def main() -> int:
    if sys.argv[1:] not in ([], ["--check"]):
        raise SystemExit(__doc__)
    uses = declared()
    faults = check(uses)
    if not faults:
        picture = draw(uses)
        if not sys.argv[1:]:
            PICTURE.write_text(picture)
        elif not PICTURE.is_file() or PICTURE.read_text() != picture:
            faults.append(f"{PICTURE.relative_to(ROOT)} is not current; tools/module_graph.py draws it")
    for fault in faults:
        print(fault, file=sys.stderr)
    print(f"modules: {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
