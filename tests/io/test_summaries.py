"""A record's JSON holds what the contract promises, in shop units, with null for what is not known."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from modal_fits import cut_off, single, six_by_three

from millcal.data import Channel, Posterior, Recording
from millcal.io.parameter_summary import posterior_summary
from millcal.io.readable import _plus_minus, brief_of, table, text_of
from millcal.io.summaries import summarise, value_at


def finite(value):
    """Whether a JSON tree is free of nan and infinity, which JSON cannot say."""
    json.dumps(value, allow_nan=False)
    return True


def test_a_summary_is_json_without_nan_and_a_text_has_no_nan_either(record):
    assert finite(summarise(record))
    assert "nan" not in text_of(record)
    assert text_of(record) == text_of(record).rstrip()
    assert len(brief_of(record)) <= len(text_of(record))


def test_coefficients_are_told_by_name_with_value_unit_sd_and_interval(make_record):
    told = summarise(make_record("coefficients"))
    assert told["coefficients"]["Ktc"] == {
        "value": pytest.approx(900.0), "unit": "N/mm^2", "sd": pytest.approx(1e-6),
        "ci95": [pytest.approx(800.0), pytest.approx(1000.0)],
    }  # fmt: skip
    assert told["coefficients"]["Krc"]["ci95"] == [pytest.approx(100.0), None]
    assert set(told["r2"]) == {"x", "y", "z"}
    assert told["verdict"] == "fits"
    assert told["left_out"] is None


def test_the_names_of_runout_carry_their_unit_and_exponents_none():
    posterior = Posterior(
        names=("kt", "mt", "Kte", "c0"), units=("N/m^2", "1", "N/m", "m"), mean=np.array([5e8, 0.3, 2e4, 11e-6]),
        covariance=np.diag([1e12, 1e-4, 1e6, 1e-12]), interval=np.zeros((4, 2)), law="kienzle", method="nls",
    )  # fmt: skip
    told = posterior_summary(posterior)
    assert {name: entry["unit"] for name, entry in told.items()} == {
        "kt": "N/mm^2", "mt": "1", "Kte": "N/mm", "c0_um": "um",
    }  # fmt: skip
    assert told["c0_um"]["value"] == pytest.approx(11.0)
    assert told["c0_um"]["sd"] == pytest.approx(1.0)
    assert told["Kte"]["value"] == pytest.approx(20.0)


def test_a_parallel_offset_seen_in_full_is_told_as_rho_and_lambda_at_the_bottom(make_record):
    """c0 + j s0 = rho exp(j (lambda + kappa)) at mid depth, kappa = (a_p / 2) tan(helix) / R."""
    fit = make_record("coefficients")
    kappa = float(fit.cutter.helix_lag(1.5e-3))
    c0, s0 = 5e-6 * np.cos(np.radians(110) + kappa), 5e-6 * np.sin(np.radians(110) + kappa)
    posterior = Posterior(
        names=("Ktc", "c0", "s0"), units=("N/m^2", "m", "m"), mean=np.array([9e8, c0, s0]),
        covariance=np.diag([1e12, 1e-14, 1e-14]),
        interval=np.array([[8e8, 1e9], [c0 - 3e-7, c0 + 3e-7], [s0 - 3e-7, s0 + 3e-7]]), law="linear-edge",
        method="nls",
    )  # fmt: skip
    told = summarise(replace(fit, posterior=posterior))["coefficients"]
    assert told["rho_um"]["value"] == pytest.approx(5.0)
    assert told["rho_um"]["sd"] == pytest.approx(0.1)
    assert told["rho_um"]["ci95"] == pytest.approx([4.7, 5.3])
    assert told["lambda_deg"]["value"] == pytest.approx(110.0)
    assert told["lambda_deg"]["sd"] == pytest.approx(np.degrees(0.1 / 5))
    small = replace(posterior, mean=np.array([9e8, 1e-7, 1e-7]))
    fit = replace(fit, posterior=small)
    told = summarise(fit)["coefficients"]
    assert told["rho_um"]["ci95"][0] == 0.0
    assert (told["lambda_deg"]["value"], told["lambda_deg"]["ci95"]) == (None, [None, None])
    assert "lambda_deg" in text_of(fit)


def test_an_frf_tells_its_hits_and_the_median_coherence_is_unknown_for_single_hits(make_record):
    told = summarise(make_record("frf"))
    assert told["coherence_median"] is None
    assert told["frequency_hz"] == [0.0, 39.0, 40]
    assert told["hits"][0] == {
        "recording": "a.h5", "index": 0, "onset_s": 0.1, "peak_N": 250.0, "accepted": False, "reasons": ["double"],
        "remarks": [],
    }  # fmt: skip


def test_a_recording_tells_its_channels():
    recording = Recording(
        samples=np.zeros((1, 500)), sample_rate=1000.0, channels=(Channel("fx", "force", "N", "tipX"),), name="a.csv"
    )
    told = summarise(recording)
    assert told["duration_s"] == 0.5
    assert told["channels"] == [{"name": "fx", "quantity": "force", "unit": "N", "dof": "tipX"}]
    assert "a.csv" in text_of(recording)


def test_modes_given_by_hand_are_told_as_they_were(make_record):
    modes = make_record("modes")
    assert summarise(modes) == {
        "modes": [
            {"axis": "x", "fn_hz": 900.0, "zeta": 0.01, "k_N_per_m": 1e7, "m_kg": pytest.approx(0.31272, rel=1e-4),
             "c_Ns_per_m": pytest.approx(35.368, rel=1e-4)}
        ]
    }  # fmt: skip


@pytest.mark.parametrize("made", [six_by_three, single, cut_off])
def test_fitted_modes_are_json_and_text_without_nan(made):
    modes = made()
    assert finite(summarise(modes))
    assert not re.search(r"\b(nan|inf|None)\b", text_of(modes))


def test_a_fitted_mode_is_a_spring_a_mass_and_a_damper_at_every_point_that_is_hit_and_measured():
    told = summarise(six_by_three())
    mode = told["modes"][0]
    w = 2 * np.pi * mode["fn_hz"]
    assert mode["k_N_per_m"] == pytest.approx(mode["m_kg"] * w**2)
    assert mode["c_Ns_per_m"] == pytest.approx(2 * mode["zeta"] * mode["m_kg"] * w)
    assert list(mode["driving"]) == ["tipX", "tipY", "tipZ"]
    assert {key: mode[key] for key in mode["driving"]["tipX"]} == mode["driving"]["tipX"]
    for entry in (mode, *mode["driving"].values()):
        for key in [key for key in entry if key.endswith("_ci95")]:
            low, high = entry[key]
            assert 0 <= low < entry[key.removesuffix("_ci95")]
            assert high is None or high > entry[key.removesuffix("_ci95")]
    hardly = mode["driving"]["tipZ"]  # as stiff as can be, for all that the hits tell
    assert hardly["k_N_per_m_ci95"][1] is None
    wrong = told["modes"][1]["driving"]["tipZ"]  # below zero, and more than the noise could do
    assert set(wrong.values()) == {None}
    assert value_at(told, "modes.0.driving.tipX.k_N_per_m") == mode["k_N_per_m"]


def test_a_fit_tells_how_well_it_explains_each_frf():
    modes = six_by_three()
    told = summarise(modes)
    assert told["residual"]["noseX"]["tipY"] == modes.fit.residual[3, 1]
    assert value_at(told, "residual.noseX.tipY") == modes.fit.residual[3, 1]
    assert told["band_hz"] == [300.0, 3000.0]
    assert np.array(told["mac"]) == pytest.approx(modes.fit.mac)
    assert told["delay_us"]["tipX"] == pytest.approx(12.0)
    low, high = told["delay_us_ci95"]["tipY"]
    assert low == pytest.approx(-high)  # no time that the response were late: as likely early
    assert "delay us behind the hammer, taken out: tipX 12.00, tipY 0, " in text_of(modes)


def test_a_delay_that_was_not_estimated_is_not_told():
    assert not [key for key in summarise(cut_off()) if key.startswith("delay")]


def test_without_hits_there_are_no_intervals_and_the_text_says_so():
    modes = single()
    told = summarise(modes)
    assert told["interval_from"] == "none"
    assert all(mode[key] is None for mode in told["modes"] for key in mode if key.endswith("_ci95"))
    assert "no intervals" in text_of(modes)
    assert "+-" not in "".join(text_of(modes).splitlines()[:-1])


def test_without_a_driving_point_there_is_no_stiffness_and_the_text_says_why():
    modes = single()
    apart = replace(modes, fit=replace(modes.fit, outputs=("noseX",)))
    told = summarise(apart)["modes"][0]
    assert told["driving"] == {}
    assert [told[key] for key in ("k_N_per_m", "m_kg", "c_Ns_per_m")] == [None] * 3
    assert "no point is both hit (tipX) and measured (noseX)" in text_of(apart)


def test_a_hammer_that_counts_the_other_way_round_does_not_turn_the_stiffness():
    modes = six_by_three()
    turned = replace(
        modes, fit=replace(modes.fit, outputs=("-tipX", *modes.fit.outputs[1:]), residue=-modes.fit.residue)
    )
    told, as_it_was = (summarise(m)["modes"][0]["driving"]["tipX"]["k_N_per_m"] for m in (turned, modes))
    assert told == as_it_was


@pytest.mark.parametrize(
    ("value", "bounds", "text"),
    [
        (650.1234, [650.0, 650.2468], "650.12 +- 0.12"),
        (650.1234567, [650.1234566, 650.1234568], "650.1235 +- 1e-07"),
        (35768.0, [26133.0, 56656.0], "36000 (26000 to 57000)"),
        (3.0, [0.0, 8.0], "3.0 (0.0 to 8.0)"),
        (1123.0, [458.2, None], "over 460"),
        (None, [458.2, None], "over 460"),
        (1.2, None, "1.200"),
        (None, None, "-"),
    ],
)
def test_a_value_of_a_mode_shows_the_digits_that_its_interval_deserves(value, bounds, text):
    modes = six_by_three()
    first = summarise(modes)["modes"][0]
    assert _plus_minus(first["fn_hz"], first["fn_hz_ci95"]) in text_of(modes)
    assert _plus_minus(value, bounds) == text


SUMMARY = {
    "coefficients": {"Ktc": {"value": 700.0, "ci95": [690.0, 710.0]}, "c0_um": {"value": 11.0}},
    "best": [{"rpm": 9000.0}],
    "verdict": "fits",
    "r2": {"x": 0.9},
}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("coefficients.Ktc_N_per_mm2", 700.0),
        ("coefficients.Ktc", 700.0),
        ("coefficients.Ktc.value", 700.0),
        ("coefficients.Ktc.ci95.1", 710.0),
        ("coefficients.c0_um", 11.0),
        ("best.0.rpm", 9000.0),
        ("best.1.rpm", None),
        ("verdict", "fits"),
        ("verdict.x", None),
        ("r2.x", 0.9),
        ("r2", None),
        ("coefficients.Kxx_N_per_mm2", None),
    ],
)
def test_a_dotted_path_finds_a_value_or_nothing(path, value):
    assert value_at(SUMMARY, path) == value


def test_a_table_lines_up():
    assert table(("name", "N"), [("a", 1.0), ("long name", 12345.678), ("c", None)]) == (
        "name           N\na          1.000\nlong name  12346\nc              -"
    )
