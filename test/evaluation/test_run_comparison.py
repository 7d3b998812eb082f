"""Runs side by side, on numbers with a known answer."""

import json

import numpy as np
import pytest

from emoflow_ros.commands.compare import main
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.run_comparison import Run, compare, load_run


def report(epe, start=10.0, **configuration):
    windows = [
        {
            "t_start_s": start + 0.1 * i,
            "t_end_s": start + 0.1 * (i + 1),
            "epe_px": value,
            "angular_error_deg_s": 2.0,
            "direction_error_deg": None,
            "runtime_s": 0.1,
        }
        for i, value in enumerate(epe)
    ]
    mean = float(np.mean(epe))
    entry = {"label": "Flow EPE", "unit": "px", "value": mean, "interval_95": [None, None]}
    summary = {"epe_px": entry}
    return {
        "source": "a.bag",
        "windows_total": len(windows),
        "windows": windows,
        "summary": summary,
        "configuration": {"profile": "realtime", **configuration},
    }


@pytest.fixture
def epe():
    return np.random.default_rng(0).uniform(1, 2, 40).tolist()


def test_a_constant_gain_is_found(epe):
    better = [value - 0.25 for value in epe]
    found = {d.key: d for d in compare(Run("a", report(epe)), Run("b", report(better)))}
    flow = found["epe_px"]
    assert flow.windows == 40
    assert flow.difference == pytest.approx(-0.25)
    assert (flow.low, flow.high) == (pytest.approx(-0.25), pytest.approx(-0.25))
    assert flow.p == pytest.approx(1 / 1001)
    assert flow.significant
    assert "direction_error_deg" not in found


def test_noise_is_no_difference(epe):
    noise = np.tile([0.1, -0.1], 20)
    found = {d.key: d for d in compare(Run("a", report(epe)), Run("b", report(noise + epe)))}
    assert found["epe_px"].low < 0 < found["epe_px"].high
    assert not found["epe_px"].significant
    assert found["angular_error_deg_s"].p == 1.0  # equal in every window


def test_only_shared_windows_count(epe):
    shifted = Run("b", report(epe, start=10.0 + 0.1 * 1000))
    with pytest.raises(InputError, match="no window in common with a"):
        compare(Run("a", report(epe)), shifted)


def test_page_and_json(tmp_path, epe, capsys):
    for name, values, depth in (("one", epe, 3), ("two", [v / 2 for v in epe], 4)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "report.json").write_text(json.dumps(report(values, depth=depth)))
    out = tmp_path / "out"
    assert main([str(tmp_path / "one"), str(tmp_path / "two"), "--out", str(out)]) == 0
    assert capsys.readouterr().out.strip() == str(out / "comparison.html")
    document = json.loads((out / "comparison.json").read_text())
    assert document["changed_options"] == {"depth": [3, 4]}
    assert document["differences"][0]["difference"] == pytest.approx(-np.mean(epe) / 2)
    assert document["differences"][0]["significant"] is True
    page = (out / "comparison.html").read_text()
    assert "better" in page
    assert "depth" in page
    assert f"{np.mean(epe):.2f}" in page


def test_bad_runs(tmp_path, epe):
    with pytest.raises(InputError, match=r"cannot be read \(no such file or directory\)"):
        load_run(tmp_path)
    (tmp_path / "report.json").write_text("{}")
    with pytest.raises(InputError, match="not a report"):
        load_run(tmp_path)
    (tmp_path / "report.json").write_text(json.dumps(report(epe)))
    with pytest.raises(InputError, match="one run alone"):
        main([str(tmp_path)])
