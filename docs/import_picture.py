"""The picture of the packages and their rooms, drawn from the imports in the source.

A package stands above those that it imports, and a room to the right of those that it imports. An arrow that follows
from others is left out. Modules beside the rooms of a package are drawn as a room with the name of the package.
"""

import ast
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path

import networkx as nx

ROOT = Path(__file__).parents[1]
TOPS = ("desim", "protocols", "scenarios")
WIDTH, LABEL, MARGIN = 1090, 112, 34
"""The widths of the picture, of the name of a package, and of the margin in which long arrows run."""
ROOM, GAP, LINE = (76, 20), 15, 26
"""The size of a room, the space between two columns, and the distance of two rows of rooms."""
STYLE = (
    "text{font:12px sans-serif;fill:#1f2328;text-anchor:middle;dominant-baseline:central}"
    ".package{fill:#eef2f7;stroke:#c3ccd8}.room{fill:#fff;stroke:#8c959f}.name{font-weight:600;text-anchor:start}"
    "path{fill:none;stroke:#6b7785;stroke-width:1.2}.between{stroke:#2f6fb0;stroke-width:1.8}"
)
HEADS = "".join(
    f'<marker id="{name}" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6" orient="auto">'
    f'<path d="M0,0 8,4 0,8z" style="fill:{colour};stroke:none"/></marker>'
    for name, colour in (("thin", "#6b7785"), ("thick", "#2f6fb0"))
)


def package_of(module: str) -> str:
    """Return the package of a module."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "desim" else parts[0]


def room_of(module: str) -> str:
    """Return the room of a module, which has the name of its package if it lies beside the rooms."""
    package = package_of(module)
    below = module.removeprefix(package).strip(".").split(".")[0]
    return f"{package}.{below}" if below and (ROOT / package.replace(".", "/") / below).is_dir() else package


def imports() -> "nx.DiGraph[str]":
    """Return the graph of the rooms, with an edge from each to those that it imports."""
    graph = nx.DiGraph()
    for top in TOPS:
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            if name in {"desim", "desim.__main__"}:
                continue  # the functions for scripts, from all packages
            for module in _imported(ast.parse(path.read_text(encoding="utf-8"))):
                if module.split(".")[0] in TOPS and module != "desim" and room_of(module) != room_of(name):
                    graph.add_edge(room_of(name), room_of(module))
    return graph


def _imported(tree: ast.Module) -> Iterator[str]:
    """Yield the modules that a program imports, also those imported in functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            for name in (f"{node.module}.{alias.name}" for alias in node.names):
                path = ROOT / name.replace(".", "/")
                yield name if path.with_suffix(".py").exists() or path.is_dir() else str(node.module)


def levels(graph: "nx.DiGraph[str]") -> dict[str, int]:
    """Return the level of each node: one above the nodes that it points to, or close below those that point to it."""
    order = list(nx.topological_sort(graph))
    level: dict[str, int] = {}
    for node in reversed(order):
        level[node] = 1 + max((level[below] for below in graph[node]), default=-1)
    for node in order:
        if graph.in_degree(node) and not graph.out_degree(node):
            level[node] = min(level[above] for above in graph.predecessors(node)) - 1
    return level


def _rows(graph: "nx.DiGraph[str]") -> list[list[str]]:
    """Return the nodes of each level, the most connected first."""
    level = levels(graph)
    ranked = sorted(graph, key=lambda node: (-graph.degree(node), node))
    return [[node for node in ranked if level[node] == number] for number in range(1 + max(level.values()))]


def _rooms_of(rooms: "nx.DiGraph[str]", package: str) -> list[list[str]]:
    """Return the rooms of a package by column; none if it has no rooms."""
    inner = rooms.subgraph([room for room in rooms if package_of(room) == package])
    return _rows(inner) if len(inner) > 1 else []


def picture(rooms: "nx.DiGraph[str]") -> str:
    """Return the picture of the packages, their rooms and their imports as SVG."""
    packages = nx.DiGraph(
        (package_of(here), package_of(there)) for here, there in rooms.edges if package_of(here) != package_of(there)
    )
    packages.add_nodes_from(map(package_of, rooms))
    boxes, drawn, top = dict[str, tuple[float, float, float, float]](), list[str](), 8.0
    for row in reversed(_rows(packages)):
        columns = {package: _rooms_of(rooms, package) for package in row}
        height = 12 + LINE * max([1, *(len(column) for each in columns.values() for column in each)])
        needed = {package: LABEL + (ROOM[0] + GAP) * len(column) for package, column in columns.items()}
        spare = (WIDTH - 2 * MARGIN - 16 * (len(row) - 1) - sum(needed.values())) / len(row)
        left = float(MARGIN)
        for package in sorted(row):
            boxes[package] = (left, top, needed[package] + spare, height)
            drawn += _package(package, columns[package], rooms, boxes[package])
            left += needed[package] + spare + 16
        top += height + 22
    arrows = "".join(_between(boxes[here], boxes[there]) for here, there in nx.transitive_reduction(packages).edges)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {top - 14:g}" role="img">'
        f"<title>The packages and their rooms</title><style>{STYLE}</style><defs>{HEADS}</defs>"
        f'<rect width="{WIDTH}" height="{top - 14:g}" style="fill:#fff"/>{"".join(drawn)}{arrows}</svg>\n'
    )


def _package(
    package: str, columns: list[list[str]], rooms: "nx.DiGraph[str]", box: tuple[float, float, float, float]
) -> Iterator[str]:
    """Yield the elements of a package and its rooms."""
    x, y, width, height = box
    yield f'<rect class="package" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="5"/>'
    yield f'<text class="name" x="{x + 10:g}" y="{y + height / 2:g}">{escape(package)}</text>'
    places = {
        room: (x + LABEL + k * (ROOM[0] + GAP), y + 9 + LINE * row)
        for k, column in enumerate(columns)
        for row, room in enumerate(column)
    }
    if places:
        yield from _arrows(nx.transitive_reduction(rooms.subgraph(places)), places)
    for room, (left, above) in places.items():
        name = escape(room.rpartition(".")[2])
        yield f'<rect class="room" x="{left:g}" y="{above:g}" width="{ROOM[0]}" height="{ROOM[1]}" rx="3"/>'
        yield f'<text x="{left + ROOM[0] / 2:g}" y="{above + ROOM[1] / 2:g}">{name}</text>'


def _arrows(graph: "nx.DiGraph[str]", places: Mapping[str, tuple[float, float]]) -> Iterator[str]:
    """Yield an arrow from the left side of each room to the right side of each room that it imports."""
    for here, there in graph.edges:
        (x0, y0), (x1, y1) = places[here], places[there]
        y0, y1 = y0 + ROOM[1] / 2, y1 + ROOM[1] / 2
        half, bend = x0 - GAP / 2, x0 - GAP + 5
        line = f"M{x0:g},{y0:g} C{half:g},{y0:g} {half:g},{y1:g} {bend:g},{y1:g} H{x1 + ROOM[0]:g}"
        yield f'<path marker-end="url(#thin)" d="{line}"/>'


def _between(upper: tuple[float, float, float, float], lower: tuple[float, float, float, float]) -> str:
    """Return the arrow from a package to one below; it runs in the right margin if others stand between."""
    below, end = upper[1] + upper[3], lower[1]
    if end - below < LINE:
        x = (max(upper[0], lower[0]) + min(upper[0] + upper[2], lower[0] + lower[2])) / 2
        line = f"M{x:g},{below:g} V{end:g}"
    else:
        start, aside = upper[0] + upper[2] - 20, WIDTH - MARGIN / 2
        between_rows = below + 11  # the space below the row, so that no box is crossed
        line = (
            f"M{start:g},{below:g} V{between_rows:g} H{aside:g} V{lower[1] + lower[3] / 2:g} H{lower[0] + lower[2]:g}"
        )
    return f'<path class="between" marker-end="url(#thick)" d="{line}"/>'
