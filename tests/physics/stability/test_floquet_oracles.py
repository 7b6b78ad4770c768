"""Floquet multipliers and crossings against converged numbers of others, and against printed tables to their digits."""

import numpy as np
import pytest
from stability_cases import RPM, TYPES, case_cut, case_name, cut, machine, oracles

from millcal.physics.stability.floquet import all_crossings, boundary, multipliers, spectral_radius
from millcal.physics.stability.stable_depths import edges_of

CASES = pytest.mark.parametrize("case", oracles()["cases"], ids=case_name)
CROSSED = [(case, deepest) for case in oracles()["cases"] for deepest in {row["amax_m"] for row in case["crossings"]}]
SEARCHES = pytest.mark.parametrize("search", [boundary, all_crossings])
SEARCHED = [
    pytest.param(
        search,
        case,
        deepest,
        id=f"{search.__name__} {case_name(case)}",
        marks=pytest.mark.long if search is all_crossings and number % 4 else (),
    )
    for search in (boundary, all_crossings)
    for number, (case, deepest) in enumerate(CROSSED)
]


def kind_of(multiplier):
    """H, F or N as the oracles have it."""
    return "H" if abs(multiplier.imag) > 1e-9 else "F" if multiplier.real < 0 else "N"


def printed(text):
    """A number as printed, with half a unit of its last digit as tolerance, and a tenth of that for how well it was found."""
    decimals = len(text.split(".")[1]) if "." in text else 0
    return pytest.approx(float(text), abs=0.55 * 10.0**-decimals)


def row_name(value):
    """Names of tests: of a printed row its first words alone."""
    return str(value)[:12]


@CASES
def test_multipliers_are_those_of_the_oracles_converged_and_at_the_order_of_the_rule(case):
    """|mu| to 1e-6 at high order and 1e-4 at the rule's; the multiplier and its kind as well."""
    tip, this = machine(case["modes"]), case_cut(case)
    rows = case["multipliers"]
    speed, depth = np.array([row["rpm"] for row in rows]) * RPM, np.array([row["ap_m"] for row in rows])
    size = [row["abs_mu"] for row in rows]
    assert spectral_radius(speed, depth, tip, this) == pytest.approx(size, abs=1e-4)
    for w, b, row in zip(speed, depth, rows, strict=True):
        largest = multipliers(w, b, tip, this, order=row["n2"])[:1]
        assert abs(largest[0]) == pytest.approx(row["abs_mu"], abs=1e-6)
        assert largest[0].real == pytest.approx(row["re"], abs=1e-6)
        assert abs(largest[0].imag) == pytest.approx(abs(row["im"]), abs=1e-6)
        assert kind_of(largest[0]) == row["type"]


@pytest.mark.parametrize(("search", "case", "deepest"), SEARCHED)
def test_edges_of_stability_are_those_of_the_oracles(search, case, deepest):
    """Every depth at which stability is lost or comes back: 1e-7 m at high order, with its kind and its sense."""
    tip, this = machine(case["modes"]), case_cut(case)
    for row in case["crossings"]:
        if row["amax_m"] != deepest:
            continue
        known = row["list"]
        speed = np.array([row["rpm"]]) * RPM
        edges = edges_of(search(speed, tip, this, deepest=deepest, order=row["n2"]), complete=True)
        assert edges.depth == pytest.approx([at["ap_m"] for at in known], abs=1e-7), row["rpm"]
        assert list(edges.kind) == [TYPES[at["type"]] for at in known], row["rpm"]
        assert list(edges.loses) == [at["loses_stability"] for at in known], row["rpm"]


def test_depths_at_the_order_of_the_rule_are_off_by_less_than_a_micrometre_or_a_ten_thousandth():
    """All first crossings of the oracles at once; where |mu| hardly grows with depth, 1e-4 of it are more depth."""
    for case in oracles()["cases"]:
        rows = [row for row in case["crossings"] if row["list"]]
        speed = np.array([row["rpm"] for row in rows]) * RPM
        deepest = max(row["amax_m"] for row in rows)
        first = edges_of(boundary(speed, machine(case["modes"]), case_cut(case), deepest=deepest), complete=True)
        first = first.first(len(speed))
        assert first.depth == pytest.approx([row["list"][0]["ap_m"] for row in rows], rel=1e-4, abs=1e-6)


# |mu| and depths of other computations, as they were printed: rpm, mm: |mu|
PRINTED_MULTIPLIERS = [
    ("IS1", 2, 1.0, "down", "5000 .2 .819742784, 5000 .5 1.073975587, 5000 .7 1.221556136, 5000 1 1.406473525, 5000 1.5 1.62804"),
    ("IS1", 2, 0.05, "down", "10000 1 .70489335, 14000 2 .85139493, 20000 1 .94634315"),
    ("IS1", 2, 0.1, "down", "10000 1 .58200344, 14000 2 .84213216, 20000 1 .98178246"),
    ("IS1", 2, 0.5, "down", "10000 1 .38548544, 14000 2 .83909686, 20000 1 1.04449208"),
    ("IS1", 2, 1.0, "down", "10000 1 1.23246922, 14000 2 .99577724, 20000 1 .86661290"),
    ("IS1", 2, 0.1, "up", "10000 1 1.03228279, 14000 2 .93263081"),
    ("IS1", 2, 0.5, "up", "10000 1 1.37996690, 14000 2 1.01828217"),
    ("IS2", 2, 0.05, "down", "5000 .5 .74687272, 10000 1 .95092052, 15000 1 .95620895"),
    ("IS2", 2, 0.1, "down", "5000 .5 .84778557, 10000 1 1.00519347, 15000 1 .96915603"),
    ("IS2", 2, 0.5, "down", "5000 .5 2.01141608, 10000 1 1.97265024, 15000 1 1.44368969"),
    ("IS2", 2, 1.0, "down", "5000 .5 5.09774535, 10000 1 4.31345, 15000 1 2.70124"),
    ("AB603", 3, 0.5, "up", "8000 1 .956434"),
    ("AB603", 3, 0.5, "down", "8000 1 .744600"),
    ("AB603", 4, 0.5, "up", "8000 1 .939122"),
    ("AB603", 4, 0.5, "down", "8000 1 .817067"),
    ("SYM500", 4, 0.5, "up", "7000 .3 .867857"),
    ("SYM500", 4, 1.0, "up", "7000 .3 .864716"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "teeth", "immersion", "direction", "rows"), PRINTED_MULTIPLIERS, ids=row_name)
def test_printed_multipliers_come_out_to_every_digit(name, teeth, immersion, direction, rows):
    """The slot at 5000 rpm is where first-order semi-discretization with 200 steps still is 2e-3 off."""
    for row in rows.split(","):
        rpm, depth, size = row.split()
        this = cut(teeth, immersion, direction, name)
        largest = multipliers(float(rpm) * RPM, float(depth) * 1e-3, machine(name), this, tolerance=1e-9)[0]
        assert abs(largest) == printed(size), row


# rpm: edges of stability in mm with their kinds, those after the first where they were printed; > none below
PRINTED_DEPTHS = [
    ("IS1", 2, 0.05, "down", "6000 3.0713, 8000 2.1632, 10000 4.0907, 12000 1.6805, 14000 >8, 18000 1.2951, 22000 1.7414"),
    ("IS1", 2, 0.1, "down", "6000 1.7329, 8000 1.2204, 10000 2.5184, 12000 .9430, 14000 6.0260, 18000 .8157, 22000 .9637"),
    ("IS1", 2, 0.5, "down", "6000 1.1389, 8000 .7979, 10000 2.1047, 12000 .6131, 14000 3.0905, 18000 1.6197, 22000 .6018"),
    ("IS1", 2, 1.0, "down", "6000 .3532, 8000 .6764, 10000 .3224, 12000 2.1493, 14000 2.1400, 18000 .6895, 22000 3.1150"),
    ("IS1", 2, 1.0, "down", "5000 .40863H, 6000 .35322H, 7000 1.15199H, 7500 .32057H, 8000 .67639H, 9000 3.00921H, 10000 .32238H"),
    ("IS1", 2, 0.1, "down", "5000 1.29626H, 6000 1.73292H, 7000 2.98782F, 7500 1.92132F 2.35581F 2.55198H, 8000 1.22042H, "
     "9000 2.44105H, 10000 2.51841F"),
    ("IS1", 2, 0.05, "down", "5000 2.20692H, 6000 3.07133H, 7000 4.84687F, 7500 2.62264F, 8000 2.16316H, 9000 4.31646H, "
     "10000 4.09071F"),
    ("IS2", 2, 1.0, "down", "5000 .04751H, 6000 .04835H, 7500 .05480H, 9000 .34622H, 10000 .07141H, 14000 .4607, 20000 .06322"),
    ("IS2", 2, 0.5, "down", "10000 .18103, 14000 1.16574, 20000 .17616"),
    ("IS2", 2, 0.1, "down", "5000 .91644H, 6000 .84292H, 7500 .83660H, 9000 6.72706H, 10000 .97012H"),
    ("IS2", 2, 0.05, "down", "5000 1.84380H, 6000 1.53627H, 7500 1.48320H, 8000 2.2294, 9000 11.29324H, "
     "10000 1.48695H, 18000 3.66487"),
    ("AB603", 3, 0.5, "up", "6000 2.02847H, 8000 1.09823H, 10000 1.36498H, 12000 4.29113H"),
    ("AB603", 3, 0.5, "down", "6000 5.17474H, 8000 4.09140H, 10000 4.48502H, 12000 11.79674H"),
    ("AB603", 4, 0.5, "up", "6000 .82210H, 8000 1.29042H, 10000 2.97491H, 12000 1.17559H"),
    ("AB603", 4, 0.5, "down", "6000 2.85187H, 8000 3.88651H, 10000 5.67897H, 12000 3.20044H"),
    ("SYM500", 4, 0.5, "up", "3000 .61540H, 4000 1.40222H, 5000 .62452H, 6000 1.73711H"),
    ("SYM500", 4, 1.0, "up", "3000 .22738H, 4000 .58067H, 5000 .22886H, 6000 .54317H"),
    ("FLEXURE", 1, 5 / 15.88, "down", "2500 7.79251H, 3000 2.56558F 4.95428F 7.11042H, 3500 3.40265H, 3679 6.33290H, "
     "3750 10.69471H, 3873 >12, 3920 10.73921F, 4000 8.92305F, 4117 7.20995F, 4222 6.12507F, 4252 5.86098F, 4400 4.74230F, "
     "4500 4.10073F, 4567 3.70390F, 4750 2.72027F, 5000 1.90966F, 5233 7.23551H, 5500 4.39657H, 6000 3.27544H, 6500 3.69398H, "
     "7000 5.85903H, 7250 9.02270H, 7500 >12"),
]  # fmt: skip


@SEARCHES
@pytest.mark.parametrize(("name", "teeth", "immersion", "direction", "rows"), PRINTED_DEPTHS, ids=row_name)
def test_printed_depths_come_out_to_every_digit(search, name, teeth, immersion, direction, rows):
    """First limits, islands of stability and their kinds, of the benchmark and of the flexure of Cornelius et al. (2021)."""
    rows = [(float(rpm), [text.rstrip("HF") for text in at], [text[-1] for text in at if text[-1] in "HF"])
            for rpm, *at in (row.split() for row in rows.split(","))]  # fmt: skip
    speed = np.array([rpm for rpm, *_ in rows]) * RPM
    found = search(speed, machine(name), cut(teeth, immersion, direction, name), deepest=12e-3, tolerance=1e-8)
    edges = edges_of(found, complete=True)
    for at, (rpm, depths, kinds) in enumerate(rows):
        here = edges.depth[edges.speed == at] * 1e3
        if depths[0].startswith(">"):
            assert not np.any(here < float(depths[0][1:])), rpm
            continue
        assert len(here) >= len(depths), rpm
        for depth, text in zip(here, depths, strict=False):
            assert depth == printed(text), rpm
        assert [TYPES[letter] for letter in kinds] == list(edges.kind[edges.speed == at][: len(kinds)]), rpm
