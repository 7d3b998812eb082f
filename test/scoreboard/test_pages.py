"""The scoreboard's table, report and command line."""

import re
from pathlib import Path

import numpy as np
import pytest
from scoreboard_tables import random_table, row, silent

from benchmarks.scoreboard import report, simulated_subjects
from benchmarks.scoreboard.__main__ import parse_seeds
from benchmarks.scoreboard.figures import figures_of
from benchmarks.scoreboard.picture import event_picture
from benchmarks.scoreboard.run import Outcome, save_windows, severity
from benchmarks.scoreboard.simulated_subjects import RandomSubject
from benchmarks.scoreboard.subjects import shared_subjects
from benchmarks.scoreboard.summary import summarise
from benchmarks.scoreboard.table import table
from benchmarks.scoreboard.verdicts import judge
from benchmarks.scoreboard.windows import WINDOW, make_windows
from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError

CAMERA = Camera(96, 72, 80.0, 80.0, 48.0, 36.0)


def outcome(name, windows):
    figures = figures_of(windows)
    picture = event_picture(Events.empty(), CAMERA)
    factors = {"scene": "room"}
    return Outcome(
        name, name.split("/")[0], figures, judge(figures), windows, 1.0, factors, picture
    )


@pytest.fixture(scope="module")
def outcomes():
    bad = [outcome(f"random/{k:04d}", random_table(k, 20)) for k in range(11)]
    return [
        outcome("random/good", make_windows([row(), row()])),
        *bad,
        outcome("real/none", make_windows([])),
    ]


@pytest.fixture(scope="module")
def document(outcomes):
    return summarise(outcomes, load_config(), ["real/gone (/nowhere)"], 0.0)


@pytest.fixture(scope="module")
def written(tmp_path_factory, outcomes, document):
    """The report's page, with pages of the two worst recordings: each takes a second to draw."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "WORST", 2)
        return report.write_report(tmp_path_factory.mktemp("report"), outcomes, document)


def test_the_report_links_to_the_worst(written: Path, outcomes):
    page = written.read_text()
    links = set(re.findall(r'href="(pages/[^"]+)"', page))
    assert len(links) == 2
    assert all((written.parent / link).exists() for link in links)
    assert "real/gone" in page
    assert page.count('<td class="picture">') == len(outcomes)
    assert not any("good" in link for link in links)


def test_the_table_names_what_is_missed_and_missing(document):
    text = table(document)
    lines = text.splitlines()
    assert len([line for line in lines if line.startswith("random/")]) == 2 * 12
    assert "missing: real/gone (/nowhere)" in lines
    assert re.search(r"real/none +-.*accurate, consistent", text)


def test_scores_are_the_first_table(outcomes):
    few = [outcomes[0], outcome("random/silent", make_windows([silent(), silent()])), outcomes[-1]]
    lines = table(summarise(few, load_config(), [], 0.0)).splitlines()
    assert re.split(r"  +", lines[0]) == [
        "recording",
        *("gain of w, bits", "of", "gain of v, bits", "of", "EPE with zero flow, %", "of"),
    ]
    w, v = few[0].figures.gain_w_bits, few[0].figures.gain_v_bits
    rows = [re.split(r"  +", line) for line in lines[1:10]]
    good = [f"{w:.2f}", f"{v:.2f}", "5.0"]
    half = [f"{w / 2:.2f}", f"{v / 2:.2f}"]
    assert [row[:1] + row[1::2] for row in rows] == [
        ["random/good", *good],
        ["random/silent", "0.00", "0.00", "100.0"],
        ["real/none", "-", "-", "-"],
        ["all, median", *half, "52.5"],
        ["all, mean", *half, "22.4"],  # sqrt(5 * 100)
        ["random, median", *half, "52.5"],
        ["random, mean", *half, "22.4"],
        ["real, median", "-", "-", "-"],
        ["real, mean", "-", "-", "-"],
    ]
    assert [row[2::2] for row in rows] == [["2"] * 3] * 2 + [["0"] * 3] + [["2"] * 3] * 4 + [
        ["0"] * 3
    ] * 2


def test_scores_are_the_first_table_of_the_report_and_of_its_json(
    written: Path, outcomes, document
):
    assert list(document).index("scores") < list(document).index("rates")
    page = written.read_text()
    first = page[page.index("<table") : page.index("</table>")]
    cells = [re.sub(r"<[^>]*>", " ", line).split() for line in first.splitlines() if "<td" in line]
    assert len(cells) == 2 * len(document["scores"]) + len(outcomes)
    geometric = document["scores"]["all"]["epe_share_all"]["geometric mean"]
    assert cells[1][:2] == ["all,", "mean"]
    assert cells[1][-3:] == [f"{geometric:.1f}", "12", "recordings"]
    assert [cells[6][0], cells[6][2], *cells[6][-2:]] == ["random/good", "2", "5.0", "2"]


def test_the_worst_recordings_miss_most(outcomes):
    ranked = sorted(outcomes, key=severity)
    assert ranked[0].verdict.missed == []
    assert len(ranked[-1].verdict.missed) == max(len(o.verdict.missed) for o in outcomes)


def test_windows_are_stored_as_they_are(tmp_path, outcomes):
    save_windows(tmp_path, outcomes[:2])
    with np.load(tmp_path / "windows" / "random-0000.npz") as archive:
        assert archive["windows"].dtype == WINDOW
        assert archive["windows"].tobytes() == outcomes[1].windows.tobytes()  # NaN included
    assert outcomes[1].document()["windows"] == "windows/random-0000.npz"


def test_recordings_that_are_not_there_say_so(tmp_path):
    missing = {subject.name: subject.missing for subject in shared_subjects(tmp_path)}
    assert missing["independent/calm"] == tmp_path / "independent" / "calm_data.bag"
    assert missing["real/slider_depth"] == tmp_path / "ecd" / "slider_depth"


@pytest.mark.parametrize("text", ["5", "5:5", "a:b", "-1:4"])
def test_seeds_are_a_range(text):
    assert parse_seeds("3:6") == range(3, 6)
    with pytest.raises(InputError, match="--seeds"):
        parse_seeds(text)


def test_random_recordings_are_simulated_once(tmp_path, monkeypatch):
    calls = []
    simulate, draw = simulated_subjects.simulate_random, simulated_subjects.draw_factors

    def counted(factors, **options):
        calls.append(factors)
        return simulate(factors, **options)

    monkeypatch.setattr(simulated_subjects, "simulate_random", counted)
    fixed = {"sensor": "240x180", "image_motion": "2", "calibration_error": "0.02"}
    monkeypatch.setattr(simulated_subjects, "draw_factors", lambda seed: draw(seed, fixed))
    first, second = (RandomSubject(7, tmp_path, duration_s=0.1).load() for _ in range(2))
    assert len(calls) == 1
    assert len(list(tmp_path.iterdir())) == 1
    np.testing.assert_array_equal(first.events.t, second.events.t)
    assert first.calibration == second.calibration != first.camera
    assert first.factors["image_motion"] == 2
    assert "seed" not in first.factors
    uncached = RandomSubject(7, None, duration_s=0.1).load()
    np.testing.assert_array_equal(uncached.events.t, first.events.t)
    assert len(calls) == 2
