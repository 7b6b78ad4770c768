"""The figures of a judged cut: the same bytes each time, the chatter named, nothing of it where there is none."""

import numpy as np
import pytest

from millcal.data import ChatterPeak, Judgement
from millcal.report import judge_figure
from millcal.report.paper.judge import judgement_file


def judgement(chatter=True, quantity="displacement"):
    """A record drawn by hand."""
    frequency = np.linspace(0.0, 4000.0, 1001)
    spectrum = 1e-8 + 1e-6 * (np.arange(1001) % 100 == 0)
    remaining = np.full(1001, 1e-8)
    if chatter:
        spectrum[230], remaining[230] = 5e-6, 5e-6
    time = np.arange(200) / 400.0
    return Judgement(
        name="cut.h5",
        channel="tip",
        quantity=quantity,
        unit="m",
        teeth=4,
        sample_rate=8000.0,
        spindle_frequency=100.0,
        spindle_frequency_sd=0.001,
        steady=(0.1, 0.6),
        revolutions=50,
        verdict="chatter" if chatter else "stable",
        why="a line at 920 Hz",
        period=None if chatter else 1,
        metric=4e-6 if chatter else 1e-8,
        chatter_frequency=920.0 if chatter else None,
        chatter_frequency_sd=0.01 if chatter else None,
        peaks=(ChatterPeak(920.0, 5e-6, 0.9),) if chatter else (),
        frequency=frequency,
        spectrum=spectrum,
        remaining=remaining,
        sample_time=0.1 + time,
        once_per_tooth=1e-6 * np.cos(2.3 * np.arange(200)),
        overview_time=np.linspace(0, 0.7, 300),
        overview_low=np.full(300, -2e-6),
        overview_high=np.full(300, 2e-6),
    )


@pytest.mark.parametrize("chatter", [True, False])
@pytest.mark.parametrize("quantity", judge_figure.SYMBOLS)
def test_every_kind_is_drawn_and_the_same_record_gives_the_same_bytes(chatter, quantity):
    found = judgement(chatter, quantity)
    first = judgement_file(found, "svg")
    assert first == judgement_file(found, "svg")
    assert [figure.name for figure in judge_figure.figures(found)] == [
        "judge-spectrum",
        "judge-teeth",
        "judge-overview",
    ]


def test_chatter_is_marked_with_its_frequency_and_only_where_there_is_some():
    drawn, quiet = (judge_figure.spectrum(judgement(chatter)).charts[0] for chatter in (True, False))
    assert "920 Hz" in drawn
    assert "920 Hz" not in quiet


def test_the_spectrum_is_drawn_beyond_the_chatter_but_not_to_the_end_of_the_band():
    found = judgement()
    assert 920.0 < judge_figure.highest_drawn(found) <= 4000.0
    assert judge_figure.marked_lines(found) == [(920.0, 5e-6)]
    assert judge_figure.marked_lines(judgement(chatter=False)) == []
