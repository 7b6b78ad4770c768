"""The report: one valid page, offline, whatever records there are."""

import dataclasses
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from millcal.report.digits import fixed, significant
from millcal.report.page import render

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """Checks that the tags balance; collects ids, headings, links, figures and the text that is seen."""

    def __init__(self, text):
        super().__init__()
        self.open, self.ids, self.links, self.text, self.figures = [], [], [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        known = dict(attributes)
        if "id" in known:
            self.ids.append(known["id"])
        self.links += [known[key] for key in ("href", "src") if key in known]
        if tag == "figure":
            self.figures.append({"svg": 0, "table": 0, "csv": 0, "named": True, "id": known["id"]})
        if "figure" in self.open or tag == "figure":
            figure = self.figures[-1]
            if tag == "svg" and "chart" in known.get("class", ""):
                figure["svg"] += 1
                figure["named"] &= len(known.get("aria-label", "")) > 20
            figure["table"] += tag == "table"
            figure["csv"] += known.get("class") == "csv"
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        if tag not in VOID:
            self.handle_starttag(tag, attributes)
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"script", "style", "textarea"} & set(self.open):
            self.text.append(data)

    @property
    def seen(self):
        return " ".join(" ".join(self.text).split())


@pytest.fixture(scope="module")
def html(results, summary, provenance):
    return render(results, summary, provenance)


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def test_the_page_is_valid_with_every_id_once_and_every_link_inside(page):
    assert len(page.ids) == len(set(page.ids))
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)


def test_nothing_is_loaded_from_anywhere(html, page):
    assert all(link.startswith("#") or link == "data:," for link in page.links)
    assert re.findall(r"https?://[^\"'\s<]+", html) == ["http://www.w3.org/2000/svg"]  # a name, not an address
    assert "url(" not in html
    assert "@import" not in html
    assert "default-src 'none'" in html


def test_the_same_input_gives_the_same_bytes(html, results, summary, provenance):
    assert render(results, summary, provenance) == html
    turned = dict(reversed(provenance.items()))
    assert render(dict(reversed(results.items())), summary, turned) == html


def test_it_stays_far_below_three_megabytes(html):
    assert len(html.encode()) < 1_600_000


def test_markup_in_names_is_text(html, page):
    assert "<AlMg3>" not in html
    assert 'Slot series in aluminium <AlMg3> & "friends"' in page.seen
    assert 'title = "Slot <series>"' in page.seen


def test_every_figure_has_charts_with_a_name_and_a_table_and_a_csv(page):
    assert len(page.figures) > 10
    for figure in page.figures:
        assert figure["svg"] >= 1, figure
        assert figure["named"], figure
        assert figure["table"] == figure["csv"] == 1, figure


def test_nothing_unknown_is_shown_as_nan_or_none(page):
    assert not re.search(r"\b(nan|inf|None|undefined)\b", page.seen)


def test_verdicts_are_words_and_signs(page):
    assert "✕ The force model does not fit the 5 cuts" in page.seen
    assert "! Stable or not: too close to tell at 6000 rpm and 1.2 mm" in page.seen
    assert "✕ Not what the recipe expects" in page.seen


def test_the_numbers_of_the_records_are_all_there(page, results, provenance):
    fit, found, map_ = results["coefficients"], results["frf"], results["stability"]
    for value in (
        "890",
        "700 to 1090",
        "−140 to 460",
        "22",
        "11.2",
        "9.8 to 12.6",
    ):  # coefficients as their intervals allow
        assert value in page.seen
    for ratio in np.concatenate([fit.left_out_by_cut.ravel(), fit.in_sample, fit.left_out_wide]):
        assert fixed(float(ratio), 3) in page.seen
    for check in fit.checks:
        assert check.message in page.seen
    for hit in found.hits:
        assert significant(hit.peak, 4) in page.seen
    assert "11 of 12 hits used" in page.seen
    for cut in results["cuts"]:
        assert fixed(60 * cut.spindle_frequency, 2) in page.seen
        assert fixed(100 * float(cut.synchronous_share[2]), 2) in page.seen
    for best in map_.best:
        assert fixed(best.spindle_speed * 60 / (2 * np.pi), 0) in page.seen
        assert fixed(best.safe_depth * 1e3, 2) in page.seen
    assert significant(map_.absolute_minimum * 1e3) in page.seen
    for digest in provenance["inputs"].values():
        assert digest in page.seen


def test_every_warning_is_told_once(page, results, summary):
    records = [*results["cuts"], results["frf"], results["coefficients"], results["stability"]]
    messages = [notice.message for record in records for notice in record.notices]
    messages += [warning["message"] for warning in summary["warnings"]]
    for message in messages:
        assert page.seen.count(message) == 1


def test_the_csv_under_a_chart_begins_with_names_and_units(html):
    assert "spindle speed [rpm],limit depth [mm],limit low [mm],limit high [mm],chatter frequency [Hz],lobe" in html
    assert "frequency [Hz],magnitude [(m/s²)/N],magnitude low" in html


@pytest.mark.parametrize("missing", ["cuts", "frf", "coefficients", "stability"])
def test_a_missing_record_leaves_its_sections_out_and_no_empty_heading(missing, results, summary, provenance):
    left = {name: record for name, record in results.items() if name != missing}
    page = Page(render(left, summary, provenance))
    gone = {
        "cuts": "Does the force follow",
        "frf": "Frequency response",
        "coefficients": "Cutting coefficients",
        "stability": "Best speeds",
    }
    assert gone[missing] not in page.seen


@pytest.mark.parametrize("only", ["cuts", "frf", "coefficients", "stability"])
def test_one_record_alone_makes_a_page(only, results):
    page = Page(render({only: results[only]}, {}, {}))
    assert len(page.figures) >= 1


def test_the_dynamometer_has_a_section_of_its_own_beside_the_structure(results):
    sensor = dataclasses.replace(results["frf"], form="transmissibility", notices=())
    page = Page(render({**results, "sensor": sensor}, {}, {}))
    assert len(set(page.ids)) == len(page.ids)
    assert {"frf", "sensor"} <= set(page.ids)
    assert page.seen.count("N/N") > 0


def test_nothing_at_all_still_makes_a_page():
    assert "Calibration report" in Page(render({}, {}, {})).seen


def test_optional_fields_may_be_missing(results, summary, provenance):
    empty = {
        "frf": {"coherence": None, "variance": None, "force_spectrum": None, "multiple_coherence": None, "hits": ()},
        "stability": {
            "limit_low": None,
            "limit_high": None,
            "best": (),
            "operating_point": None,
            "operating_p_stable": None,
            "operating_limit": None,
            "operating_limit_interval": None,
        },
        "coefficients": {
            "in_sample": None,
            "left_out": None,
            "left_out_by_cut": None,
            "in_sample_wide": None,
            "left_out_wide": None,
            "alternatives": (),
            "checks": (),
            "band": (0, 0),
        },
    }
    changed = {name: dataclasses.replace(results[name], **fields) for name, fields in empty.items()}
    page = Page(render({**results, **changed}, summary, provenance))
    assert not re.search(r"\b(nan|inf|None)\b", page.seen)
    assert "Each cut predicted" not in page.seen


def test_one_cut_without_intervals_and_a_map_without_a_limit_are_told_as_such(results):
    fit = results["coefficients"]
    lone = {
        f.name: getattr(fit, f.name)[:1]
        for f in dataclasses.fields(fit)
        if f.metadata.get("dims", ("",))[0] == "cut" and getattr(fit, f.name) is not None
    }
    posterior = dataclasses.replace(fit.posterior, interval=np.full_like(fit.posterior.interval, np.nan))
    fit = dataclasses.replace(
        fit, posterior=posterior, cuts=fit.cuts[:1], conditions=fit.conditions[:1], verdict="fits", **lone
    )
    unlimited = dataclasses.replace(
        results["stability"],
        limit_depth=np.full(1500, np.inf),
        limit_low=None,
        limit_high=None,
        chatter_frequency=np.full(1500, np.nan),
        lobe=np.full(1500, np.nan),
        absolute_minimum=np.inf,
        absolute_minimum_frequency=np.nan,
        best=(),
        operating_limit=None,
        operating_limit_interval=None,
        operating_p_stable=None,
    )
    page = Page(render({"coefficients": fit, "stability": unlimited}, {}, {}))
    assert "✓ The force model fits the 1 cut" in page.seen
    assert "none found" in page.seen
    assert not re.search(r"\b(nan|inf|None)\b", page.seen)


def test_of_many_cuts_a_spread_is_drawn_and_all_are_listed(results):
    cuts = tuple(dataclasses.replace(results["cuts"][0], name=f"cut{number:02d}.txt") for number in range(40))
    html = render({"cuts": cuts}, {}, {})
    page = Page(html)
    assert len(page.figures) == 12
    assert "12 of 40 cuts are drawn" in page.seen
    assert all(cut.name in page.seen for cut in cuts)
    assert len(html.encode()) < 3_000_000


def test_an_expectation_may_be_the_beginning_of_a_text(page):
    assert "does not fit does not fit ✓ yes" in page.seen


def test_colours_change_with_the_scheme_and_paper_is_light(html):
    style = re.search(r"<style>(.*?)</style>", html, re.DOTALL)[1]
    palettes = re.findall(r":root \{(.*?)\}", style, re.DOTALL)
    names = [set(re.findall(r"--[a-z-]+(?=:)", palette)) for palette in palettes]
    assert len(palettes) == 3
    assert names[0] == names[1] == names[2]
    assert set(re.findall(r"var\((--[a-z-]+)\)", style)) <= names[0]


def _luminance(colour):
    value = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(value <= 0.03928, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_text_and_lines_have_contrast_in_light_in_dark_and_on_paper(html):
    for palette in re.findall(r":root \{(.*?)\}", html, re.DOTALL):
        colour = dict(re.findall(r"(--[a-z-]+): (#[0-9a-f]{6})", palette))
        pairs = [("--ink", "--paper", 7), ("--muted", "--paper", 4.5), ("--muted", "--raised", 4.5)]
        pairs += [(f"--{kind}", f"--{kind}-back", 4.5) for kind in ("good", "part", "bad")]
        pairs += [(line, "--paper", 3) for line in ("--main", "--model", "--third", "--fourth", "--fifth")]
        for front, back, least in pairs:
            bright, dark = sorted((_luminance(colour[front]), _luminance(colour[back])), reverse=True)
            assert (bright + 0.05) / (dark + 0.05) >= least, (front, back)
