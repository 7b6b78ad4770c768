"""Nodes and directions of a universal file as dofs, and dofs as nodes and directions.

A dof is a point and a direction with its sign: node 1 along -x is `-1X`, the entity `tip` along y `tipY`. The entity names
the point where it stands for one node only and the node for it; otherwise the node's number does.
"""

import re
from collections.abc import Iterable, Sequence

from millcal.io.formats.universal_records import Dof

DIRECTIONS = {0: "", 1: "X", 2: "Y", 3: "Z", 4: "RX", 5: "RY", 6: "RZ"}
LONGEST = 10  # letters of an entity
_SPLIT = re.compile(r"(?P<sign>[+-]?)(?P<point>.*?)(?P<direction>R?[XYZxyz]?)")


def dof_names(dofs: Iterable[Dof]) -> dict[Dof, str]:
    """The dof that each node with its direction is called by.

    >>> list(dof_names([Dof("", 1, 1), Dof("", 2, -3), Dof("tip", 7, 2), Dof("4+Z", 4, 3)]).values())
    ['1X', '-2Z', 'tipY', '4Z']
    """
    known = list(dict.fromkeys(dofs))
    points = {dof: _entity_without_direction(dof) for dof in known}
    entities: dict[int, set[str]] = {}
    nodes: dict[str, set[int]] = {}
    for dof, entity in points.items():
        entities.setdefault(dof.node, set()).add(entity)
        nodes.setdefault(entity, set()).add(dof.node)
    names = {}
    for dof, entity in points.items():
        told = entity and len(nodes[entity]) == 1 and (dof.node == 0 or len(entities[dof.node]) == 1)
        names[dof] = _named(entity if told else str(dof.node), dof.direction)
    if len(set(names.values())) < len(_places(known)):  # an entity is called as another node is numbered
        names = {dof: _named(f"{points[dof]}:{dof.node}".lstrip(":"), dof.direction) for dof in known}
    return names


def _places(dofs: Sequence[Dof]) -> set[tuple[str, int, int]]:
    """The places that must have different names: a node is one place whatever it is called, the node 0 is many."""
    return {(dof.entity if dof.node == 0 else "", dof.node, dof.direction) for dof in dofs}


def _entity_without_direction(dof: Dof) -> str:
    """`1+Z` of node 1 along z is `1`; the direction is said once."""
    letter = DIRECTIONS[abs(dof.direction)]
    bare = re.sub(rf"[ :_]*[+-]{letter}$", "", dof.entity, flags=re.IGNORECASE) if letter else dof.entity
    return "" if bare == str(dof.node) else bare


def _named(point: str, direction: int) -> str:
    return f"{'-' if direction < 0 else ''}{point}{DIRECTIONS[abs(direction)]}"


def split_dof(dof: str) -> tuple[str, int]:
    """The point and the direction of a dof.

    >>> split_dof("tipX"), split_dof("-12Z"), split_dof("hammer")
    (('tip', 1), ('12', -3), ('hammer', 0))
    """
    found = _SPLIT.fullmatch(dof)
    assert found is not None  # every text fits
    letters = {name: number for number, name in DIRECTIONS.items()}
    direction = letters[found["direction"].upper()]
    return found["point"], -direction if found["sign"] == "-" else direction


def nodes_of(dofs: Iterable[str]) -> dict[str, Dof]:
    """A node, an entity and a direction for each dof: a number is its own node, a name the next one that is free."""
    known = list(dict.fromkeys(dofs))
    points = list(dict.fromkeys(split_dof(dof)[0] for dof in known))
    numbered = {point: int(point) for point in points if point.isascii() and point.isdigit() and 0 < int(point) < 10**9}
    free = (n for n in range(1, len(points) + len(numbered) + 2) if n not in numbered.values())
    nodes = {point: numbered[point] if point in numbered else next(free) for point in points}
    entities = {point: "" if point in numbered else point[:LONGEST].strip() for point in points}
    return {dof: Dof(entities[point], nodes[point], way) for dof in known for point, way in [split_dof(dof)]}
