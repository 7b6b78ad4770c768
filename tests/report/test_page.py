"""The report: one valid page, offline, whatever records there are."""

import dataclasses
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from millcal.data import Check, Notice
from millcal.report.digits import fixed, rounded_down, significant
from millcal.report.page import render
from millcal.report.tables import spectrum
from millcal.report.wording import QUESTIONS, question

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
        assert rounded_down(best.safe_depth * 1e3, 2) in page.seen
    assert significant(map_.absolute_minimum * 1e3) in page.seen
    for digest in provenance["inputs"].values():
        assert digest in page.seen


def test_every_warning_is_told_once(page, results, summary):
    records = [*results["cuts"], results["frf"], results["coefficients"], results["stability"]]
    messages = [notice.message for record in records for notice in record.notices]
    messages += [warning["message"] for warning in summary["warnings"]]
    for message in messages:
        assert page.seen.count(message) == 1


def test_warnings_and_notes_stand_apart_and_only_warnings_are_counted():
    told = {"code": "offset-removed", "message": "removed an offset of 4.5 N", "where": "a.csv"}
    page = Page(render({}, {"warnings": [{**told, "message": "the rows are fewer"}], "notes": [told]}, {}))
    assert "1 warning" in page.seen
    assert page.ids.index("warnings") < page.ids.index("notes")
    order = [page.seen.index(text) for text in ("Warnings !", "the rows are fewer", "Notes removed")]
    assert order == sorted(order)
    assert page.seen.count("removed an offset") == 1


def test_notes_alone_are_no_warnings(results):
    quiet = dataclasses.replace(results["cuts"][0], notices=(Notice("filter", "no low-pass", "", "note"),))
    page = Page(render({"cuts": [quiet]}, {}, {}))
    assert "notes" in page.ids
    assert "arning" not in page.seen


def test_a_message_of_several_places_stands_once_with_its_places(cuts):
    notice = Notice("rows-against-header", "the rows are taken")
    told = [dataclasses.replace(cut, notices=(dataclasses.replace(notice, where=cut.name),)) for cut in cuts]
    again = {"code": notice.code, "message": notice.message, "where": cuts[0].name}
    page = Page(render({"cuts": told}, {"warnings": [again]}, {}))
    assert page.seen.count("the rows are taken") == 1
    assert "f300, f600, f900, f1200, f1500 · rows-against-header" in page.seen
    assert "1 warning" in page.seen


def test_a_cut_has_one_name_everywhere(results):
    bare = tuple(cut.name.removeprefix("cuts/").removesuffix(".txt") for cut in results["cuts"])
    fit = dataclasses.replace(results["coefficients"], cuts=bare)
    page = Page(render({"cuts": results["cuts"], "coefficients": fit}, {}, {}))
    assert all(page.seen.count(name) > 4 for name in bare)
    assert ".txt" not in page.seen


def test_the_best_speeds_say_the_safe_depth_and_what_it_removes(page, stability):
    best = stability.best[0]
    removal = significant(best.removal_rate * best.safe_depth / best.axial_depth * 6e7)  # cm^3/min
    assert "speed, rpm safe a p , mm removal rate, cm³/min limit a p , mm" in page.seen
    assert "p stable" not in page.seen
    assert removal in page.seen


def test_without_a_band_the_best_speeds_say_the_limit_and_that_it_is_no_safe_depth(stability):
    bare = tuple(dataclasses.replace(best, safe_depth=None, p_stable=None) for best in stability.best)
    page = Page(render({"stability": dataclasses.replace(stability, best=bare)}, {}, {}))
    assert "speed, rpm limit a p , mm removal rate, cm³/min" in page.seen
    assert "No band is known" in page.seen
    assert "safe a" not in page.seen


@pytest.mark.parametrize(
    ("verdict", "doubt"),
    [("does not fit: chatter", "that do not fit"), ("fits in part: x", "that are provisional"), ("fits", None)],
)
def test_a_map_of_doubtful_coefficients_says_so_at_its_own_place_and_is_never_green(verdict, doubt, results):
    fit = dataclasses.replace(results["coefficients"], verdict=verdict)
    certain = dataclasses.replace(results["stability"].operating, p_stable=1.0)
    stable = dataclasses.replace(results["stability"], operating=certain)
    html = render({"coefficients": fit, "stability": stable}, {}, {})
    section = Page(html[html.index('<section id="stability">') :].partition("</section>")[0] + "</section>")
    assert ("The map rests on coefficients" in section.seen) == (doubt is not None)
    assert doubt is None or doubt in section.seen
    assert ("✓ Stable at 6000 rpm" in Page(html).seen) == (doubt is None)


def test_units_of_messages_are_set_as_in_print_and_stored_text_stays(coefficients):
    check = Check("offset", False, "teeth differ by 4.5 um; Ktc 820 N/mm2, 3.4% in y, cut_um.csv")
    page = Page(render({"coefficients": dataclasses.replace(coefficients, checks=(check,))}, {}, {}))
    assert "teeth differ by 4.5 µm; Ktc 820 N/mm², 3.4 % in y, cut_um.csv" in page.seen
    assert "4.5 um" in check.message


def test_what_does_not_fit_is_said_over_the_figures_that_show_it(coefficients):
    checks = (Check("contact-loss", False, "bad"), Check("offset", True, "good"), Check("untested", False, "two cuts"))
    html = render({"coefficients": dataclasses.replace(coefficients, checks=checks)}, {}, {})
    page = Page(html)
    assert "Why the model does not fit ✕ Teeth lose contact by runout : see harmonic 1" in page.seen
    assert "✕ Too few cuts to test the model ." in page.seen
    assert 'href="#harmonics"' in html
    assert "Alternating and mean forces agree passed · offset" in page.seen
    fits = dataclasses.replace(coefficients, verdict="fits")
    assert "Why the model" not in Page(render({"coefficients": fits}, {}, {})).seen


def test_shares_of_the_measured_alternating_force_add_up_to_the_whole(coefficients):
    rows = np.array([[float(cell) for cell in row[1:]] for row in spectrum(coefficients).rows])
    assert rows[:, ::2].sum(axis=0) == pytest.approx(100, abs=0.16)
    assert np.all(rows[2, 1::2] < rows[2, ::2])  # a model without what noise adds between the tooth passings


@pytest.mark.parametrize("name", ["axis-map", "untested", "resonance", "offset", "line", "models", "left-out"])
def test_a_known_check_is_a_statement_either_way(name):
    asked = question(name)
    assert asked.passed != asked.failed
    assert question("some-new-check").passed == "Some new check"


def test_on_paper_facts_and_short_tables_stay_whole(html, page):
    paper = re.search(r"@media print \{(.*)\n\}", html, re.DOTALL)[1]
    whole = re.search(r"([^}]*)\{ break-inside: avoid; \}", paper)[1]
    assert {".short", ".whole", ".facts", ".verdict"} <= set(re.findall(r"\.\w+", whole))
    for title in ("What was removed before the fit", "Best speeds"):
        assert re.search(rf'<div class="tabular short">\s*<h3>{title}', html)


def test_the_csv_under_a_chart_begins_with_names_and_units(html):
    assert (
        "spindle speed [rpm],limit depth [mm],limit low [mm],limit high [mm],kind,chatter frequency [Hz],lobe" in html
    )
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
            "operating": None,
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
        operating=dataclasses.replace(
            results["stability"].operating, limit=np.inf, limit_interval=None, p_stable=None, stable=True, kind=""
        ),
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
    assert all(cut.name.removesuffix(".txt") in page.seen for cut in cuts)
    assert len(html.encode()) < 3_000_000


def test_an_expectation_may_be_the_beginning_of_a_text(page):
    assert "does not fit does not fit ✓ yes" in page.seen


def test_of_a_long_verdict_the_expectations_show_the_beginning():
    entry = {"key": "verdict", "value": "does not fit: " + "chatter; " * 20, "interval": "does not fit", "ok": True}
    page = Page(render({}, {"expect": [entry]}, {}))
    assert "verdict does not fit … does not fit ✓ yes" in page.seen
    assert "chatter" not in page.seen


def test_every_place_that_a_check_sends_to_is_there(results):
    checks = tuple(Check(name, False, "no") for name in QUESTIONS)
    fit = dataclasses.replace(results["coefficients"], checks=checks)
    for given in ({**results, "coefficients": fit}, {"coefficients": fit}):
        page = Page(render(given, {}, {}))
        assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
        assert all(page.seen.count(asked.failed) >= 2 for asked in QUESTIONS.values())


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
