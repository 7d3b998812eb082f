"""The command `evaluate`: a recording in, egomotion, flow and a report out."""

import argparse
import copy
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from emoflow_ros import cli
from emoflow_ros.commands import compare
from emoflow_ros.config import Config, load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.ablation import ABLATIONS, ablate, variants_of
from emoflow_ros.evaluation.benchmark_sequences import find_sequence
from emoflow_ros.evaluation.estimates_file import EstimatesWriter
from emoflow_ros.evaluation.gyro_check import check_lines
from emoflow_ros.evaluation.protocols import (
    CAUSAL,
    DSEC,
    POLICIES,
    PROTOCOLS,
    WINDOWS,
    Plan,
    adapt_windows,
    make_plan,
)
from emoflow_ros.evaluation.provenance import versions
from emoflow_ros.evaluation.recording_options import (
    Source,
    add_configuration_options,
    add_imu_options,
    add_recording_options,
    make_folder,
    overrides,
    positive,
    positive_number,
    read_gyro,
    shares,
    with_choice,
)
from emoflow_ros.evaluation.run_progress import Checkpoint, Progress
from emoflow_ros.evaluation.track_errors import TrackComparer
from emoflow_ros.evaluation.window_run import Evaluation, proceed
from emoflow_ros.factory import make_estimator
from emoflow_ros.readers import KNOWN_FORMATS, require_camera
from emoflow_ros.readers.column_arguments import column_options
from emoflow_ros.report.ablation_table import table_of
from emoflow_ros.report.report_writer import Report, write_report
from emoflow_ros.truth import load_truth
from emoflow_ros.truth.dsec_flow import Submission

_EXIT_NOTHING_ESTIMATED = 1
_EPILOG = """\
examples:
  evaluate recording.bag --calib camera.yaml
  evaluate indoor_flying1_data.bag --gt indoor_flying1_gt.bag indoor_flying1_gt_flow_dist.npz
  evaluate shapes_rotation/ --window-ms 98 --out out/shapes
  evaluate indoor_flying1_data.hdf5 --sequence indoor_flying1 --protocol mvsec-dt4 \\
           --gt indoor_flying1_gt.bag indoor_flying1_gt_flow_dist.npz
  evaluate zurich_city_02_a/ --protocol dsec
  evaluate zurich_city_12_a/ --protocol dsec --timestamps zurich_city_12_a.csv \\
           --submission out/submission
  evaluate recording.bag --tracks 150
  evaluate recording.bag --imu /davis/left/imu --check-imu
  evaluate recording.bag --gt recording_gt.bag --ablate huber
  evaluate compare out/run1 out/run2     (runs side by side; evaluate compare --help)

writes into DIR: report.html, report.json, windows.csv and estimates.h5 (docs/estimates_file.md).
exit codes: 0 done, 1 no window could be estimated, 2 bad input, 130 interrupted (what was done
until then is written), 141 nobody reads the output.
"""


def main() -> int:
    """Entry point."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["compare"]:
        return cli.run(lambda: compare.main(arguments[1:]))
    return cli.run(lambda: _run(parse(arguments)))


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Parse the command line of `evaluate`, without its name."""
    parser = argparse.ArgumentParser(
        prog="evaluate",
        description="Estimate egomotion and optical flow of a recording, without ROS running, and "
        "compare them with ground truth.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("input", type=Path, metavar="INPUT", help=KNOWN_FORMATS)
    add(
        "--gt",
        type=Path,
        nargs="+",
        default=[],
        metavar="GT",
        help="ground truth: bags or MVSEC's *_gt.hdf5 with poses and depth, MVSEC's "
        "*_gt_flow_dist.npz and *_odom.npz, a DSEC sequence, text files of poses "
        "(t tx ty tz qx qy qz qw), ECD's motion.txt (default: what lies in the folder of an ECD or "
        "DSEC sequence, or stamped_groundtruth.txt beside an HDF5 file with columns)",
    )
    add_recording_options(parser)
    add_configuration_options(parser)
    add_imu_options(parser)
    add(
        "--protocol",
        default=WINDOWS,
        choices=PROTOCOLS,
        help="which intervals are compared (docs/evaluation.md; default: windows)",
    )
    add(
        "--policy",
        default=CAUSAL,
        choices=POLICIES,
        help="which events an interval is estimated from: those of a window that ends with it, or "
        "the published code's fixed number, also from the future (default: causal)",
    )
    add(
        "--timestamps",
        type=Path,
        metavar="FILE",
        help="DSEC's intervals of a test sequence, <sequence>.csv, or the folder with it "
        "(default: in INPUT)",
    )
    add(
        "--submission",
        type=Path,
        metavar="DIR",
        help="write the flow images for DSEC's server into DIR/<sequence>",
    )
    add("--out", type=Path, metavar="DIR", help="folder for results (default: out/<name of INPUT>)")
    add(
        "--resume",
        action="store_true",
        help="continue the interrupted run in DIR exactly where it was saved (every 10 s)",
    )
    add("--save-flow", action="store_true", help="store the dense flow of each window, too")
    add(
        "--tracks",
        type=positive,
        default=0,
        metavar="N",
        help="carry N points along the flow: drawn in the report, stored in estimates.h5",
    )
    add(
        "--speed",
        type=positive_number,
        metavar="M_S",
        help="the camera's speed, m/s, where it is known: scale of the trajectory (default: the "
        "truth's, an oracle)",
    )
    add(
        "--ablate",
        choices=ABLATIONS,
        help="then evaluate again with this part of the method changed, on the same windows",
    )
    add("--max-windows", type=positive, metavar="N", help="stop after N windows")
    return parser.parse_args(arguments)


def _run(options: argparse.Namespace) -> int:
    _require_dsec(options)
    config = load_config(options.profile, overrides(options))
    config = with_choice(config, options.imu, check=options.check_imu)
    config = replace(config, window=adapt_windows(config.window, options.protocol, options.policy))
    if options.ablate:
        variants_of(options.ablate, config)  # refused before anything is estimated
    sequence = find_sequence(options.sequence) if options.sequence else None
    folder = options.out or Path("out") / options.input.resolve().stem
    source = Source(options.input, options.topic, options.calib, sequence, column_options(options))
    with source.open() as recording:
        camera = require_camera(recording)
        truth = load_truth(recording, options.gt)
        plan = make_plan(
            options.protocol,
            recording,
            truth,
            config.window,
            sequence,
            clips=options.policy,
            test_times=options.timestamps,
        )
        submission = _submission(options, plan, camera)
        gyro = read_gyro(recording, config.imu, options.imu)
        readings = gyro.readings if gyro and not options.check_imu else None
        make_folder(folder)
        checkpoint = Checkpoint(folder / "checkpoint.pickle", _identity(options, config, plan))
        done = checkpoint.load() if options.resume else None
        progress = done or Progress(
            make_estimator(camera, config),
            copy.deepcopy(plan.slicer),
            tracker=TrackComparer(options.tracks, camera) if options.tracks else None,
        )
        with EstimatesWriter(
            folder / "estimates.h5",
            camera=camera,
            source=str(options.input),
            configuration=config.flat(),
            save_flow=options.save_flow,
            tracks=options.tracks,
            keep=len(progress.windows),
        ) as writer:
            run = proceed(
                recording,
                progress,
                plan.truth,
                protocol=plan.description,
                gyro=readings,
                writer=writer,
                submission=submission,
                checkpoint=checkpoint,
                max_windows=options.max_windows,
                progress_bar=True,
            )
        ablation = None
        if options.ablate and not run.interrupted:
            ablation = ablate(
                options.ablate,
                config,
                recording,
                plan.slicer,
                run,
                gyro=readings,
                max_windows=options.max_windows,
            )
    if not run.windows:  # interrupted before the first one was done
        raise KeyboardInterrupt
    run.published, run.speed = plan.published, options.speed
    run.imu = gyro.description if gyro and readings else ""
    report = write_report(run, config.flat(), folder, ablation)
    _print_summary(run, report)
    if gyro and options.check_imu:
        print("\n".join(check_lines(run.windows, gyro, config.imu)))
    if submission and not run.interrupted:
        submission.report()
    if ablation:
        print(table_of(ablation))
        if ablation.interrupted:
            print("interrupted: the table has the variants done until then", file=sys.stderr)
            return cli.EXIT_INTERRUPTED
    if run.interrupted:
        print("interrupted; the same command with --resume continues", file=sys.stderr)
        return cli.EXIT_INTERRUPTED
    return 0 if any(w.ok for w in run.windows) else _EXIT_NOTHING_ESTIMATED


def _require_dsec(options: argparse.Namespace) -> None:
    """Refuse options of DSEC's protocol with another one."""
    for name in ("timestamps", "submission"):
        if getattr(options, name) is not None and options.protocol != DSEC:
            raise InputError(f"--{name}", f"is for protocol {DSEC} only", f"give --protocol {DSEC}")


def _submission(options: argparse.Namespace, plan: Plan, camera: Camera) -> Submission | None:
    """Prepare the flow images of --submission."""
    if options.submission is None:
        return None
    name = options.sequence or options.input.resolve().name
    return Submission(options.submission, name, plan.images, camera, keep=options.resume)


def _identity(options: argparse.Namespace, config: Config, plan: Plan) -> dict[str, Any]:
    """What has to be the same for a run to be continued."""
    return {
        "input": str(options.input.resolve()),
        "topic": options.topic,
        "calibration": str(options.calib),
        "columns": str(column_options(options)),
        "truth": plan.truth.description,
        "protocol": plan.description,
        "--imu": str(options.imu),
        "--check-imu": options.check_imu,
        "configuration": config.flat(),
        "choice of --save-flow": options.save_flow,
        "--submission": str(options.submission),
        "number of --tracks": options.tracks,
        "version": versions(),
    }


def _print_summary(run: Evaluation, report: Report) -> None:
    print(run.outcome)
    if run.imu:
        print(f"IMU: {run.imu}; gyro {shares(w.gyro for w in run.windows)}")
    for m in report.measures:
        interval = f"  [{m.low:.2f}, {m.high:.2f}]" if m.low == m.low else ""
        print(f"  {m.label:<50} {m.value:9.2f} {m.unit:<6}{interval}")
    print(f"in {run.wall_s:.1f} s, reading and comparison included")
    print(report.html)


if __name__ == "__main__":
    sys.exit(main())
