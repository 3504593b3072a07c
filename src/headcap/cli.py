"""`headcap ...`: what a user does beside the batch stages."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import headcap
from headcap.artifacts import ArtifactError
from headcap.errors import InputError, InputErrors


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status: 0 well, 1 the input or result is not, 2 wrong usage."""
    options = _parser().parse_args(arguments)
    try:
        return options.command(options)
    except (InputError, InputErrors, ArtifactError, FileNotFoundError) as error:
        print(f"headcap: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="headcap", description="From the recordings of a camera rig to a tracked head.")
    parser.add_argument("--version", action="version", version=f"headcap {headcap.__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def add(name: str, command, help_text: str) -> argparse.ArgumentParser:
        """A subcommand and the function that runs it, which takes the parsed options and returns the exit status."""
        sub = commands.add_parser(name, help=help_text, description=help_text)
        sub.set_defaults(command=command)
        return sub

    check = add("check", _check, "Check a session or study and its recordings without running anything.")
    check.add_argument("session", type=Path, help="YAML file")

    run = add("run", _run, "Run a session or study, with progress.")
    run.add_argument("session", type=Path, nargs="?", default=Path("config/demo.yaml"), help="YAML file (default: the demo)")
    run.add_argument("options", nargs=argparse.REMAINDER, help="further options go to snakemake")

    rehearse = add("rehearse", _rehearse, "Render the recordings of a described rig, with their truth.")
    rehearse.add_argument("config", type=Path, help="YAML file of rehearsal settings, or a session with a rehearse key")
    rehearse.add_argument("folder", type=Path, help="where the recordings go")

    metrics = add("metrics", _metrics, "Print the figures of a session.")
    metrics.add_argument("results", type=Path, help="results folder of a session, or its metrics.json")

    provenance = add("provenance", _provenance, "Print the tree of what a result was made from.")
    provenance.add_argument("file", type=Path, help="an artifact or its manifest")

    export = add("export", _export, "Write a rig or a mesh sequence in another program's format.")
    export.add_argument("source", type=Path, help="rig.json or sequence.json")
    export.add_argument("target", type=Path, help="file or folder to write")
    export.add_argument(
        "--format", required=True, help="npz, pc2, obj, glb of a sequence; colmap, opencv_yaml, kalibr, ... of a rig"
    )
    export.add_argument("--template", type=Path, help="template or start.npz whose triangles a sequence has")

    _add_neck_commands(add)
    _add_lip_commands(add)

    _add_expression_commands(add)
    _add_schema(add)
    return parser


def _add_expression_commands(add: Callable[..., argparse.ArgumentParser]) -> None:
    """`quasi-eigen` and `convert-weights`."""
    faces = add("quasi-eigen", _quasi_eigen, "Turn hand-made expressions into a basis that covers a captured performance.")
    faces.add_argument(
        "--performance",
        type=Path,
        nargs="+",
        required=True,
        help="what was captured: sequence.json, npy, PC2, USD, a folder of OBJ or PLY; or markers, C3D, TRC, CSV",
    )
    faces.add_argument("--basis", type=Path, required=True, help="hand-made shapes: folder of OBJ or PLY, glTF, USD, npz")
    faces.add_argument("--out", type=Path, required=True, help="folder to write, expressions.html in it")
    faces.add_argument("--neutral", type=Path, help="the performer at rest (default: the shapes' own neutral face)")
    faces.add_argument("--unit", choices=("m", "cm", "mm"), help="of the performance, where its files do not tell")
    faces.add_argument("--basis-unit", choices=("m", "cm", "mm", "in"), default="m", help="of a folder of shapes (default: m)")
    faces.add_argument("--rate", type=float, default=30.0, help="frames a second, where files do not tell (default: 30)")
    faces.add_argument("--landmarks", type=Path, help="vertex numbers of --neutral by landmark name, JSON, for another topology")
    faces.add_argument("--basis-landmarks", type=Path, help="the same of the shapes' neutral face")
    faces.add_argument("--components", help="principal axes: shapes (default), coverage, or a number")
    faces.add_argument("--coverage", type=float, help="share of the variance that --components coverage keeps (default: 0.995)")
    faces.add_argument(
        "--weights", choices=tuple(_WEIGHTS), default="free", help="free, not below 0, or from 0 to 1 (default: free)"
    )
    faces.add_argument("--smoothing", type=float, help="how dear a change of weights from frame to frame is")
    faces.add_argument("--sparsity", type=float, help="weight below which a shape is left out")
    faces.add_argument("--locality", type=float, help="how far each shape is kept to its own region, 0 to 1")
    faces.add_argument("--no-augment", action="store_true", help="tell of eigenfaces that the shapes leave out, but add none")
    markers = faces.add_argument_group("markers")
    markers.add_argument("--on-markers", action="store_true", help="work on the markers themselves, without a mesh between them")
    markers.add_argument("--rigid", nargs="+", metavar="NAME", help="markers that tell the head's motion (default: found)")
    markers.add_argument("--leave-out", nargs="+", metavar="NAME", default=[], help="markers that are not to be used")
    markers.add_argument("--marker-vertices", type=Path, help="vertex numbers by marker name, JSON (default: the nearest)")
    markers.add_argument("--neutral-frame", type=int, help="frame at rest (default: the first that shows all markers)")

    convert = add("convert-weights", _convert_weights, "Weights of one expression basis as weights of another.")
    convert.add_argument("weights", type=Path, help="CSV or JSON, one column per shape")
    convert.add_argument("--from", type=Path, required=True, dest="source", help="the basis that they are of")
    convert.add_argument("--to", type=Path, required=True, dest="target", help="the basis they are wanted of: one topology")
    convert.add_argument("--arkit", action="store_true", help="only the target's shapes that ARKit has, by ARKit's names")
    convert.add_argument("--weights-range", choices=tuple(_WEIGHTS), default="free", help="as of quasi-eigen")
    convert.add_argument("--out", type=Path, required=True, help="CSV or JSON to write")


_WEIGHTS = {"free": None, "positive": (0.0, float("inf")), "unit": (0.0, 1.0)}


def _add_schema(add: Callable[..., argparse.ArgumentParser]) -> None:
    """`schema`."""
    schema = add("schema", _schema, "Write or check the JSON schemas of session and study files.")
    schema.add_argument("--folder", type=Path, default=Path("config/schema"))
    mode = schema.add_mutually_exclusive_group(required=True)
    mode.add_argument("--write", action="store_true", help="write them")
    mode.add_argument("--check", action="store_true", help="exit with 1 where they are not in step with the settings")


def _add_lip_commands(add: Callable[..., argparse.ArgumentParser]) -> None:
    """`lips`, `lip-labels` and `lip-errors`."""
    lips = add("lips", _lips, "The face in a single video, tracked, with its lips corrected by what a rig has taught.")
    lips.add_argument(
        "videos", type=Path, nargs="+", metavar="video", help="any video of one face, seen from the front where it begins"
    )
    lips.add_argument("--regressor", type=Path, required=True, help="lips.npz of a study")
    lips.add_argument("--camera", type=Path, help="rig.json of the camera that took it (default: focal length estimated)")
    lips.add_argument("--camera-name", help="which of the rig's cameras")
    lips.add_argument("--detections", type=Path, help="68, 468 or 478 landmarks by frame, JSON or CSV, of any detector")
    lips.add_argument(
        "--person",
        type=Path,
        help="track.npz of another video of the same person, best of one in which the head turns (default: the video tells)",
    )
    lips.add_argument(
        "--detail",
        action="store_true",
        help="also write detailed.json: wrinkles by shading, as they differ from the first frame; slow, and as good as the track",
    )
    lips.add_argument(
        "--align",
        type=Path,
        nargs="+",
        help="what is said: lines `start end word` in seconds or 1/25000 s, named as the video where there are several "
        "(default: the .align beside each video, where there is one)",
    )
    lips.add_argument("--base-track", type=Path, help="of another tracker, in the place of our own: see the guide, with --camera")
    lips.add_argument("--base-flame", type=Path, help="the FLAME model of a --base-track of FLAME parameters")
    lips.add_argument("--base-neutral", type=Path, help="the person at rest in the topology of a --base-track of meshes")
    lips.add_argument("--base-landmarks", type=Path, help="vertex numbers of --base-neutral by landmark name, JSON")
    lips.add_argument(
        "--out", type=Path, required=True, help="folder to write, lips.html in it; one in it for each of several videos"
    )
    _add_lip_label_commands(add)
    _add_lip_errors(add)


def _add_lip_label_commands(add: Callable[..., argparse.ArgumentParser]) -> None:
    """`lip-labels begin`, `show` and `adapt`."""
    labels = add(
        "lip-labels", _begin_labels, "Lip contours drawn by hand in some frames of a video: begun, shown, and learnt from."
    )
    verbs = labels.add_subparsers(required=True, metavar="VERB")

    def verb(name: str, command, help_text: str) -> argparse.ArgumentParser:
        """One of them, with the video it is about."""
        sub = verbs.add_parser(name, help=help_text, description=help_text)
        sub.set_defaults(command=command)
        sub.add_argument("video", type=Path, help="the video whose frames are labelled")
        return sub

    begin = verb("begin", _begin_labels, "Write contours that were found in some frames, to be corrected by hand.")
    show = verb("show", _show_labels, "Draw labels over their frames, and say what is wrong with them.")
    adapt = verb("adapt", _adapt_labels, "Teach the contour detector of lips.npz the person and the light of labelled frames.")
    for sub in (begin, adapt):
        sub.add_argument("--regressor", type=Path, required=True, help="lips.npz of a study")
        sub.add_argument("--tracked", type=Path, required=True, help="folder that `headcap lips` wrote of this video")
    for sub in (show, adapt):
        sub.add_argument("labels", type=Path, help=".json, .csv, or a folder of labelme's")
    begin.add_argument("--frames", type=_numbers, metavar="K,K,...", help="which (default: some of those that were followed)")
    begin.add_argument("--count", type=int, default=6, help="how many, evenly spread, where none are named (default: 6)")
    begin.add_argument("--out", type=Path, required=True, help=".json to write, or a folder of pictures that labelme opens")
    show.add_argument("--out", type=Path, required=True, help="folder to write")
    adapt.add_argument("--out", type=Path, required=True, help="lips.npz to write, for `headcap lips --regressor`")


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(number) for number in text.split(","))


def _add_lip_errors(add: Callable[..., argparse.ArgumentParser]) -> None:
    """`lip-errors`."""
    errors = add("lip-errors", _lip_errors, "Errors of what `headcap lips` made of a video, against true meshes of any topology.")
    errors.add_argument("results", type=Path, help="folder that headcap lips wrote")
    errors.add_argument("--regressor", type=Path, required=True, help="lips.npz that it was given")
    errors.add_argument(
        "--truth", type=Path, required=True, help="sequence.json, one mesh per frame, or a truth folder's take .npz"
    )
    errors.add_argument("--template", type=Path, help="triangles, landmarks and face at rest of a sequence.json")
    errors.add_argument("--camera-name", help="which of a truth folder's cameras took the video (default: the one tracked)")


def _add_neck_commands(add: Callable[..., argparse.ArgumentParser]) -> None:
    """`animate`, `fit` and `edit`."""
    animate = add("animate", _animate, "Meshes of a person's head and neck from a voice, from coefficient curves, or from both.")
    animate.add_argument("model", type=Path, help="model.npz of a trained neck")
    animate.add_argument("regressor", type=Path, nargs="?", help="regressor.npz of the same model")
    animate.add_argument("sound", type=Path, nargs="?", help="WAV or any file with sound")
    animate.add_argument("--person", required=True, help="whose head, of those the model knows")
    animate.add_argument("--fps", type=float, default=60.0, help="frames per second that a sound is animated at (default: 60)")
    animate.add_argument("--curves", type=Path, help="curves of pose and expression; what they hold goes before the sound")
    animate.add_argument("--out", type=Path, required=True, help="sequence .json, or file or folder of the format")
    animate.add_argument("--format", default="sequence", help="sequence (default), npz, pc2, obj or glb")

    fit = add(
        "fit", _fit, "Coefficient curves of a person from meshes, or from landmarks of a tracked face, which then drive the neck."
    )
    fit.add_argument("model", type=Path, help="model.npz of a trained neck")
    fit.add_argument("--person", required=True, help="whose head, of those the model knows")
    fit.add_argument("--meshes", type=Path, help="sequence.json of meshes in the model's topology")
    fit.add_argument("--landmarks", type=Path, help=".json or .csv of landmarks over time, in metres or in pixels")
    fit.add_argument("--camera", type=Path, help="rig.json of the camera that took the pixels")
    fit.add_argument("--camera-name", help="which of the rig's cameras")
    fit.add_argument("--still-trunk", action="store_true", help="landmarks: the trunk stays, the neck does all that is seen")
    fit.add_argument("--order", default="pose,expression,larynx,speech", help="meshes: stages in the order they are solved in")
    fit.add_argument("--hold", type=Path, help="meshes: curves that are given and not solved for")
    fit.add_argument("--smooth", type=float, metavar="HZ", help="meshes: temporal prior; motion of this frequency is halved")
    fit.add_argument("--out", type=Path, required=True, help="curves .json to write")

    edit = add("edit", _edit, "Scale, offset, exaggerate, key, cut and add coefficient curves, in the order written.")
    edit.add_argument("source", help="curves .json, fits.npz of a trained neck, or the word swallow for the ready curve")
    edit.add_argument("--out", type=Path, required=True, help="curves .json to write")
    edit.add_argument("--take", help="which take of fits.npz")
    edit.add_argument("--model", type=Path, help="model of fits.npz, where it is not model.npz beside it")
    edit.add_argument("--fps", type=float, default=60.0, help="frames per second of the ready swallow (default: 60)")
    for name, form, help_text in _EDITS:
        edit.add_argument(f"--{name}", dest="operations", metavar=form, action=_InOrder, default=[], help=help_text)


_EDITS = (
    ("scale", "CURVE=FACTOR", "tau, alpha, phi, psi, neck or jaw; one component as phi.3, neck.x"),
    ("offset", "CURVE=AMOUNT", "tau in mm, neck and jaw in degrees"),
    ("exaggerate", "CURVE=FACTOR", "about the curve's mean"),
    ("key", "CURVE@SECONDS=VALUE", "bend a curve through a value; keys in a row bend it together"),
    ("cut", "FROM:TO", "seconds, or the word swallow for the highest rise of the larynx"),
    ("add", "FILE@SECONDS", "lay other curves' motion on, or the word swallow"),
    ("subtract", "FILE@SECONDS", "take it off again"),
)


class _InOrder(argparse.Action):
    """Collects (option, text) of all edits in the order in which they are written."""

    def __call__(self, parser, namespace, values, option_string=None) -> None:
        setattr(namespace, self.dest, [*getattr(namespace, self.dest), (option_string.lstrip("-"), values)])


def _check(options: argparse.Namespace) -> int:
    from headcap.workflow.check import check_recordings
    from headcap.workflow.plan import load_plan, read_document

    plan = load_plan(read_document(options.session))
    for session in plan.sessions.values():
        told = check_recordings(session)
        print(f"{session.session}: {told}")
    return 0


def _run(options: argparse.Namespace) -> int:
    from headcap.workflow.plan import load_plan, read_document
    from headcap.workflow.run import run_workflow
    from headcap.workflow.summary import summary

    plan = load_plan(read_document(options.session))
    status = run_workflow(options.session, options.options, show=lambda line: print(line, flush=True))
    if status == 0:
        for name in [plan.name] if plan.is_session else [*plan.sessions, plan.name]:
            print(summary(Path("results") / name))
    return status


def _rehearse(options: argparse.Namespace) -> int:
    from headcap.synthetic.rehearsal import rehearse
    from headcap.workflow.plan import load_rehearsal, read_document

    rehearse(load_rehearsal(read_document(options.config)), options.folder)
    print(f"recordings and truth are in {options.folder}")
    return 0


def _metrics(options: argparse.Namespace) -> int:
    from headcap.evaluation.metrics import describe, load_metrics

    path = options.results / "metrics.json" if options.results.is_dir() else options.results
    figures = load_metrics(path)
    sessions = {figure.session for figure in figures}
    alone = sessions.pop() if len(sessions) == 1 else None
    print("\n".join(describe(figure, of_session=alone) for figure in figures))
    return 0 if all(figure.ok is not False for figure in figures) else 1


def _provenance(options: argparse.Namespace) -> int:
    from headcap.artifacts.provenance import provenance_tree

    print("\n".join(provenance_tree(options.file)))
    return 0


def _export(options: argparse.Namespace) -> int:
    from headcap.workflow.convert import convert

    written = convert(options.source, options.target, options.format, template=options.template)
    print(f"wrote {written}")
    return 0


def _animate(options: argparse.Namespace) -> int:
    from headcap.workflow.animate import AnimationRequest, animate

    request = AnimationRequest(
        model=options.model,
        person=options.person,
        regressor=options.regressor,
        sound=options.sound,
        fps=options.fps,
        curves=options.curves,
        form=options.format,
    )
    for path in animate(request, options.out):
        print(f"wrote {path}")
    return 0


def _fit(options: argparse.Namespace) -> int:
    from headcap.workflow.fit import FitRequest, fit

    request = FitRequest(
        model=options.model,
        person=options.person,
        meshes=options.meshes,
        landmarks=options.landmarks,
        camera=options.camera,
        camera_name=options.camera_name,
        order=tuple(options.order.split(",")),
        hold=options.hold,
        smooth_hz=options.smooth,
        still_trunk=options.still_trunk,
    )
    for line in fit(request, options.out):
        print(line)
    print(f"wrote {options.out}")
    return 0


def _lips(options: argparse.Namespace) -> int:
    if options.base_track is not None:
        return _lips_of_base_track(options)
    from headcap.workflow.lips import correct_videos, lip_requests

    given = (options.camera, options.camera_name, options.detections, options.align or (), options.person, options.detail)
    answer = correct_videos(lip_requests(options.videos, options.regressor, *given), options.out)
    for line in answer.lines:
        print(line)
    for name, why in answer.failures.items():
        print(f"headcap: {name}: {why}", file=sys.stderr)
    print(f"wrote {options.out}")
    return 1 if answer.failures else 0


def _lips_of_base_track(options: argparse.Namespace) -> int:
    from headcap.workflow.lip_base_track import BaseTrackFiles, correct_base_track

    files = BaseTrackFiles(options.base_track, options.base_flame, options.base_neutral, options.base_landmarks)
    for option in ("person", "detail", "align"):
        if getattr(options, option):
            raise InputError(f"--{option} with --base-track", expected="one of them", remedy="Our own base tracker takes it.")
    camera = (options.camera, options.camera_name)
    return _print_written(correct_base_track(options.videos, options.regressor, files, *camera, options.out), options.out)


def _begin_labels(options: argparse.Namespace) -> int:
    from headcap.workflow.lip_labels import LabelRequest, begin_labels

    request = LabelRequest(options.video, options.regressor, options.tracked)
    return _print_written(begin_labels(request, options.out, options.frames, options.count), options.out)


def _show_labels(options: argparse.Namespace) -> int:
    from headcap.workflow.lip_labels import show_labels

    return _print_written(show_labels(options.video, options.labels, options.out), options.out)


def _adapt_labels(options: argparse.Namespace) -> int:
    from headcap.workflow.lip_labels import LabelRequest, adapt_kit

    request = LabelRequest(options.video, options.regressor, options.tracked)
    return _print_written(adapt_kit(request, options.labels, options.out), options.out)


def _print_written(lines: Sequence[str], out: Path) -> int:
    for line in (*lines, f"wrote {out}"):
        print(line)
    return 0


def _lip_errors(options: argparse.Namespace) -> int:
    from headcap.workflow.lip_truth import TruthRequest, judge_lips

    request = TruthRequest(options.results, options.regressor, options.truth, options.template, options.camera_name)
    print("\n".join(judge_lips(request)[1]))
    return 0


def _quasi_eigen(options: argparse.Namespace) -> int:
    from headcap.workflow.quasi_eigen import QuasiEigenRequest, asked_settings, make_quasi_eigen_faces

    settings = asked_settings(
        components=options.components,
        coverage=options.coverage,
        bounds=_WEIGHTS[options.weights],
        smoothing=options.smoothing,
        sparsity=options.sparsity,
        locality=options.locality,
        augment=False if options.no_augment else None,
    )
    request = QuasiEigenRequest(
        performance=tuple(options.performance),
        basis=options.basis,
        neutral=options.neutral,
        unit=options.unit,
        basis_unit=options.basis_unit,
        rate_hz=options.rate,
        landmarks=options.landmarks,
        basis_landmarks=options.basis_landmarks,
        on_markers=options.on_markers,
        rigid=options.rigid and tuple(options.rigid),
        leave_out=tuple(options.leave_out),
        marker_vertices=options.marker_vertices,
        neutral_frame=options.neutral_frame,
        settings=settings,
    )
    return _print_written(make_quasi_eigen_faces(request, options.out), options.out)


def _convert_weights(options: argparse.Namespace) -> int:
    from headcap.workflow.quasi_eigen import WeightConversionRequest, convert_weight_files

    bounds = _WEIGHTS[options.weights_range]
    request = WeightConversionRequest(options.weights, options.source, options.target, options.arkit, bounds)
    return _print_written(convert_weight_files(request, options.out), options.out)


def _edit(options: argparse.Namespace) -> int:
    from headcap.workflow.edit import edit

    curves = edit(options.source, options.operations, options.out, take=options.take, model=options.model, fps=options.fps)
    print(f"wrote {options.out}: {len(curves)} frames of {', '.join(curves.channels)}")
    return 0


def _schema(options: argparse.Namespace) -> int:
    from headcap.settings import schemas

    stale = []
    for name, schema in schemas().items():
        path, text = options.folder / f"{name}.json", json.dumps(schema, indent=1) + "\n"
        if options.write:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        elif not path.exists() or path.read_text() != text:
            stale.append(str(path))
    if stale:
        print(f"{', '.join(stale)} not in step with the settings; run: headcap schema --write", file=sys.stderr)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
