"""The blocks a section of the page is made of: tables, figures, facts, text and checks, as the template takes them."""

from collections.abc import Sequence
from dataclasses import replace

from markupsafe import Markup

from millcal.data import Check
from millcal.report.figures import Figure
from millcal.report.tables import Table
from millcal.report.wording import question


def section(name: str, title: str, *blocks: dict | None) -> dict | None:
    """A section of what there is; none where there is nothing."""
    there = [block for block in blocks if block]
    return {"name": name, "title": title, "blocks": there} if there else None


def text(words: str) -> dict:
    """A paragraph."""
    return {"kind": "text", "text": words}


def table(shown: Table | None) -> dict | None:
    """A table, where there is one."""
    return {"kind": "table", "table": shown} if shown else None


def figure(shown: Figure | None) -> dict | None:
    """A figure, where there is one."""
    if shown is None:
        return None
    return {"kind": "figure", "figure": shown, "charts": [Markup(svg) for svg in shown.charts]}


def figures(shown: Sequence[Figure], title: str, caption: str, layout: str, key: Sequence = ()) -> dict | None:
    """Several figures under one heading, side by side where the page is wide."""
    inner = [figure(one) for one in shown]
    head = {"kind": "figures", "title": title, "caption": caption, "layout": layout, "key": key}
    return {**head, "figures": inner} if inner else None


def steps(title: str, shown: Sequence[str]) -> dict | None:
    """What to do, best first."""
    return {"kind": "steps", "title": title, "steps": shown} if shown else None


def facts(title: str, shown: Sequence[tuple[str, str]]) -> dict | None:
    """Pairs of what and how much."""
    return {"kind": "facts", "title": title, "facts": shown} if shown else None


def checks(title: str, shown: Sequence[Check]) -> dict | None:
    """Checks with their answers."""
    return {"kind": "checks", "title": title, "checks": shown} if shown else None


def reasons(failed: Sequence[Check], level: str, hidden: set[str]) -> dict | None:
    """What the checks hold against a model and where on the page to see it.   hidden : figures that are not there"""
    asked = [question(check.name) for check in failed]
    if level not in ("bad", "part") or not asked:
        return None
    seen = [replace(one, place="", look="") if one.place in hidden else one for one in asked]
    title = "Why the model does not fit" if level == "bad" else "Why the model fits in part only"
    return {"kind": "reasons", "title": title, "reasons": seen}
