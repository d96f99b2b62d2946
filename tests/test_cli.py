"""The command line as a person meets it: what it prints, and what it leaves behind."""

import ctypes
import errno
import io
import json
import math
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from modiolus import __version__
from modiolus.cli import main
from modiolus.cli.catalogue import ALONE
from modiolus.cli.outputs import use_of, whole_folder, write_report
from modiolus.cli.simulate import describe, heading
from modiolus.compiling import compiler, working_time
from modiolus.errors import InputError, SolveError
from modiolus.face.expression import Expression
from modiolus.face.head import Head
from modiolus.mechanics import Settings, continuation
from modiolus.mechanics.face import FaceSettings
from modiolus.mechanics.problem import Statistics
from modiolus.progress import Interruption, Progress

COMMANDS = ["simulate", "catalogue", "beam", "build", "heads", "head", "head show", "head diff"]
COMMANDS += ["compare", "identify", "validate", "morph", "segment", "upright", "export"]
COMMANDS += ["verify", "bench", "converge"]


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    """Run the command line in an empty folder; return exit code, standard output and error."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return left.value.code, printed.out, printed.err

    return call


def assert_refused(answer, *words):
    """One line on standard error, exit code 2, nothing on standard output."""
    code, out, error = answer
    assert code == 2, error
    assert out == ""
    assert error.startswith("modiolus: ") and error.count("\n") == 1, error
    for word in words:
        assert word in error


def test_version(run):
    assert run("--version") == (0, f"modiolus {__version__}\n", "")


def test_without_a_command_it_says_how_to_begin(run):
    code, out, _ = run()
    assert code == 0
    assert "modiolus simulate smile-closed" in out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(run, command):
    code, out, _ = run(*command.split(), "--help")
    assert code == 0
    assert "Example" in out and f"modiolus {command}" in " ".join(out.split())


def test_help_has_the_usual_values_of_the_settings(run):
    _, out, _ = run("simulate", "--help")
    told = dict(re.findall(r"([a-z_]+)=([\w.]*\w)", out[out.index("--set") : out.index("--head")]))
    assert told == {
        name: f"{value}".removesuffix(".0") for name, value in vars(FaceSettings()).items()
    }


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["simulat"], ["simulate"]),
        (["head", "diff", "taro"], ["OTHER", "see modiolus head diff --help"]),
        (["simulate"], ["EXPRESSION"]),
        (["identify", "--head", "ict", "--scan", "face.ply", "--muscles", ","], ["--muscles"]),
        (["validate", ".", "--activations", ","], ["--activations", "table2"]),
        (["simulate", "smile-close"], ["smile-close", "did you mean smile-closed"]),
        (["simulate", "gone.toml"], ["gone.toml", "cannot be read"]),
        (["simulate", "smile-closed", "--head", "tara"], ["tara", "taro"]),
        (["simulate", "smile-closed", "--head", "./nowhere"], ["nowhere"]),
        (["simulate", "smile-closed", "--head", "."], [".: not a head's directory"]),
        (["simulate", "smile-closed", "--head", ""], ["'': not a head's directory"]),
        (["simulate", "--activation", "mentalis"], ["--activation mentalis", "name=value"]),
        (["simulate", "--activation", "mentalis=much"], ["--activation mentalis=much", "number"]),
        (
            ["simulate", "--activation", "mentalus=0.5"],
            ["--activation: muscle 'mentalus'", "did you mean mentalis"],
        ),
        (["simulate", "--activation", "mentalis=nan"], ["mentalis", "nan", "0 to 1"]),
        (["simulate", "--activation", "mentalis=-0.1"], ["mentalis", "-0.1", "0 to 1"]),
        (["simulate", "--activation", "mentalis=1.01"], ["mentalis", "1.01", "0 to 1"]),
        (["simulate", "--activation", "mentalis_lef=0.5"], ["mentalis_lef", "did you mean"]),
        (["simulate", "sad", "--jaw-open", "wide"], ["modiolus: --jaw-open: ", "number; mend"]),
        (["bench", "--refine", "3"], ["modiolus: --refine: ", "2; mend"]),
        (["compare", ".", "--scan", "face.ply"], [".: no state.npz"]),
        (["identify", "--markers", "."], [".: cannot be read"]),
        (["simulate", "sad", "--set", "sigma=250"], ["setting 'sigma'", "did you mean sigma_max"]),
        (["simulate", "sad", "--set", "skin"], ["--set skin", "name=value"]),
        (["simulate", "sad", "--set", "skin=nan"], ["--set skin", "nan", "from 0 up"]),
        (["simulate", "sad", "--set", "fat=0"], ["--set fat", "above 0"]),
        (["simulate", "sad", "--set", "gauss_order=2"], ["gauss_order", "3 to 8"]),
        (
            ["simulate", "sad", "--set", "gauss_order=4.5"],
            ["gauss_order=4.5", "whole number"],
        ),
        (["catalogue", "--set", "muscle=wu"], ["passive muscle 'wu'", "did you mean wu2013"]),
        (["simulate", "sad", "--out", "/dev/null"], ["--out /dev/null", "cannot be written"]),
        (["simulate", "sad", "--out", "/proc/none"], ["--out /proc/none", "cannot be written"]),
        (["simulate", "sad", "--outt", "x"], ["--outt"]),
        (["simulate", "sad", "--name", "a/b"], ["--name: 'a/b' cannot be a name", "letters"]),
        (["build", "nowhere"], ["nowhere"]),
        (["upright", "taro-upright"], ["taro-upright: it stands already"]),
        (["beam", "--angle", "steep"], ["--angle"]),
        (["beam", "--angle", "nan"], ["--angle nan"]),
        (["beam", "--angle", "120"], ["--angle 120", "-90 to 90"]),
        (["beam", "--activation", "2"], ["--activation 2", "0 to 1"]),
        (["head", "show", "--head", "tara"], ["tara", "taro"]),
    ],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_bad_input_is_one_line(run, tmp_path, arguments, words, as_json):
    assert_refused(run(*arguments, *(["--json"] if as_json else [])), *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("activations = [", ["not a TOML file"]),
        ("activations = " + 100_000 * "[", ["not a TOML file"]),
        ("", ["no activations"]),
        ("[activations]\n", ["no activations"]),
        ("[activations]\nmentalis = 'much'\n", ["mentalis", "0 to 1"]),
        ("title = 3\n[activations]\nmentalis = 0.2\n", ["my.toml", "title"]),
        ("[activations]\nmentalis = true\n", ["mentalis", "0 to 1"]),
        ("[activations]\nmentalis = nan\n", ["mentalis", "nan"]),
        ("[activations]\nmentalis = 1.5\n", ["my.toml", "mentalis", "1.5", "0 to 1"]),
        ("[activations]\nmentallis = 0.2\n", ["my.toml: ", "mentallis", "did you mean mentalis"]),
        ("[activations]\nmentalis = 0.2\nmentalis = 0.3\n", ["not a TOML file", "line 3"]),
        ("[activations.mentalis]\nleft = 0.2\n", ["activation of mentalis is {'left': 0.2}"]),
        ("activation = 1\n[activations]\nmentalis = 0.2\n", ["activation", "activations"]),
    ],
)
def test_bad_expression_file_is_one_line(run, tmp_path, text, words):
    (tmp_path / "my.toml").write_text(text)
    assert_refused(run("simulate", "my.toml"), *words)


def test_an_expression_file_has_its_ending(run, tmp_path):
    (tmp_path / "my.txt").write_text("[activations]\nmentalis = 7\n")
    (tmp_path / "my.TOML").write_text("[activations]\nmentalis = 7\n")
    assert_refused(run("simulate", "my.txt"), "my.txt", "end its name in .toml")
    assert_refused(run("simulate", "my.TOML"), "my.TOML", "mentalis is 7")


def test_no_place_for_compiled_kernels_is_one_line(run, monkeypatch):
    def load(name):
        raise RuntimeError("cannot cache function 'f': no locator available for file 'f.py'")

    monkeypatch.setattr(Head, "load", load)
    assert_refused(run("simulate", "sad"), "NUMBA_CACHE_DIR")


def test_what_overflows_is_told_in_one_line(run, monkeypatch):
    def load(name):
        raise SolveError(f"{np.float64(1e300) ** 2:g}: too much; take less")

    monkeypatch.setattr(Head, "load", load)
    code, out, error = run("simulate", "sad")
    assert (code, out, error) == (1, "", "modiolus: inf: too much; take less\n")


def test_expression_file_that_is_not_text(run, tmp_path):
    (tmp_path / "my.toml").write_bytes(bytes(range(128, 256)))
    assert_refused(run("simulate", "my.toml"), "my.toml", "not a TOML file")


def test_a_folder_of_somebody_else_is_left_alone(run, tmp_path):
    (tmp_path / "out" / "beam-0").mkdir(parents=True)
    (tmp_path / "out" / "beam-0" / "thesis.txt").write_text("mine")
    assert_refused(run("beam", "--angle", "0"), "out/beam-0", "other files")
    assert (tmp_path / "out" / "beam-0" / "thesis.txt").read_text() == "mine"


def test_beam_prints_one_json_object(run, tmp_path):
    code, out, error = run("beam", "--angle", "0", "--activation", "0.01", "--json")
    assert code == 0, error
    record = json.loads(out)
    assert record["converged"] is True
    # Fibres along the upper side shorten it: the tip rises, without twist or sideways motion.
    x, y, z = record["tip_displacement"]
    assert z > 1.0 and x < 0.0 and abs(y) < 1e-3
    assert abs(record["twist_deg"]) < 1e-3
    assert (tmp_path / record["files"]["picture"]).read_bytes()[:4] == b"\x89PNG"
    assert json.loads((tmp_path / record["files"]["report"]).read_text()) == record


def test_a_heading_says_what_was_asked_for():
    smile = Expression.shipped("smile-closed")
    assert heading(smile, {}) == smile.title
    assert heading(smile, {"risorius": 0.0}, palsy="right") == (
        f"{smile.title}, risorius 0, right side palsied"
    )
    assert heading(Expression("custom"), {}, jaw_open=20.0) == "jaw open by 20°"
    many = dict.fromkeys("abcdef", 0.5)
    assert heading(Expression("custom"), many) == "a 0.5, b 0.5, c 0.5, d 0.5, …"


def test_the_landmark_that_moved_most_is_told():
    def record(left, right, seconds=0.0):
        points = {"mouth_corner_left": left, "mouth_corner_right": right, "chin": 1.0}
        return {
            **{"expression": "sad", "head": "taro", "steps": 4, "newton_iterations": 20},
            **{"solve_s": 8.0, "compile_s": seconds, "doubts": []},
            "landmarks": {n: {"displacement": [0.0, 0.0, far]} for n, far in points.items()},
            "files": {"picture": "face.png", "report": "report.json"},
        }

    assert "8.0 s; the mouth corner moved most, 3.0 mm\n" in describe(record(3.0, 3.0))
    sides = "the mouth corner moved most, 0.0 mm on the left and 3.0 mm on the right\n"
    assert sides in describe(record(0.0, 3.0))
    assert "the chin moved most, 1.0 mm\n" in describe(record(0.0, 0.0))
    assert "8.0 s beside 27 s of compiling; " in describe(record(3.0, 3.0, 27.0))


def test_a_result_that_is_doubtful_says_so():
    assert Statistics(J_min=0.6, J_max=1.5, max_penetration_mm=0.05).doubts == ()
    found = Statistics(J_min=0.2, max_penetration_mm=2.51, jumps=1).doubts
    assert len(found) == 3
    assert found[0] == "parts that touch overlap by 2.5 mm"
    assert "20% of its volume" in found[1]
    stuck = Statistics(max_penetration_mm=0.21, pressed=False).doubts
    assert stuck == ("parts that touch overlap by 0.21 mm, and could not be pressed farther apart",)
    assert Statistics(correction_mm=3e-4).doubts == ()
    assert "by 0.008 mm" in Statistics(correction_mm=0.0081).doubts[0]


def test_a_file_without_an_end_is_refused(run, tmp_path):
    for name, arguments in (("my.toml", ["simulate"]), ("my.csv", ["identify", "--markers"])):
        (tmp_path / name).symlink_to("/dev/zero")
        assert_refused(run(*arguments, name), name, "more than 64 MiB")


@pytest.mark.parametrize("stream", ["stdout", "stderr"])
def test_a_closed_stream_changes_nothing(run, monkeypatch, stream):
    monkeypatch.setattr(sys, stream, None)
    assert run("heads")[0] == 0
    monkeypatch.setattr(sys, stream, None)
    assert run("simulate", "smile-close")[0] == 2


def test_a_terminal_without_the_letters_is_no_error(run, monkeypatch):
    printed = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", printed)
    assert run("beam", "--angle", "10", "--activation", "0.001")[0] == 0
    printed.seek(0)
    assert "twisted by 1.3\\xb0" in printed.read()


def test_a_full_disk_is_told_in_one_line(run, monkeypatch):
    def full(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("modiolus.cli.beam.write_report", full)
    code, out, error = run("beam", "--angle", "0", "--activation", "0.001", "--quiet")
    assert (code, out, error.count("\n")) == (1, "", 1)
    assert "No space left on device; mend that" in error
    assert list(Path().iterdir()) == []


def test_quiet_says_nothing(run):
    assert run("beam", "--activation", "0.001", "--quiet") == (0, "", "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_interruption_leaves_nothing(tmp_path, number):
    # The tests themselves may run under nohup, whose deafness would be inherited.
    listen = "import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL)"
    command = f"{listen}; from modiolus.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", command, "simulate", "terror"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 60.0
    while not list(tmp_path.glob("out/.*.part")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(number)
    out, error = process.communicate(timeout=60.0)
    assert process.returncode == 130
    assert out == ""
    assert error.splitlines()[-1] == "modiolus: interrupted; nothing was written"
    assert "Traceback" not in error
    assert list(tmp_path.iterdir()) == []


def test_interruption_on_the_way_keeps_the_last_state(run, monkeypatch, tmp_path):
    def stop(progress, done, message=""):
        if progress.title == "solving chin" and done > 0.05:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Progress, "update", stop)
    code, out, error = run("simulate", "--activation", "mentalis=0.1", "--name", "chin", "--json")
    assert code == 130 and out == ""
    place = Path("out") / "chin-stopped"
    words = r"modiolus: interrupted at (.+)% of the load; the state there is in (.+)"
    # Before it may stand that kernels are compiled.
    told = re.fullmatch(words, error.splitlines()[-1])
    assert told and told[2] == str(place)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["chin-stopped"]
    report = json.loads((tmp_path / place / "report.json").read_text())
    assert (report["expression"], report["converged"]) == ("chin", False)
    reached = 0.01 * float(told[1])
    assert report["activations"]["mentalis"] == pytest.approx(0.1 * reached, abs=1e-4)
    assert {path.name for path in (tmp_path / place).iterdir()} == {
        *("report.json", "state.npz", "face.png", "face.glb", "tissue.vtu"),
    }


def test_catalogue_shows_how_far_a_muscle_came(run, monkeypatch, tmp_path):
    whole = Head.load("taro")
    few = {name: whole.muscles[name] for name in ("mentalis", "procerus")}
    monkeypatch.setattr(Head, "load", lambda name: replace(whole, muscles=few))
    monkeypatch.setattr(continuation, "Settings", lambda: Settings(max_steps=1))
    code, out, error = run("catalogue", "--json")
    assert code == 1
    told = error.splitlines()[-1]
    assert told.startswith("modiolus: mentalis: ") and "; procerus: " in told
    found = json.loads(out)["runs"]
    assert [(run["expression"], run["converged"]) for run in found] == [
        ("mentalis", False),
        ("procerus", False),
    ]
    reached = ALONE[few["mentalis"].kind] * Settings().first_step
    assert found[0]["activations"]["mentalis"] == pytest.approx(reached)
    assert (tmp_path / "out/catalogue/procerus/face.png").is_file()


def test_lost_interruption_is_raised_again(tmp_path, monkeypatch):
    lost = []
    monkeypatch.setattr(sys, "unraisablehook", lambda event: lost.append(event.exc_type))
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    callback = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))
    try:
        Interruption.listen()
        with (
            pytest.raises(KeyboardInterrupt),
            whole_folder(tmp_path / "run", marker="report.json") as folder,
        ):
            (folder / "report.json").write_text("{}")
            callback()
        assert lost == [KeyboardInterrupt]
        assert list(tmp_path.iterdir()) == []
        with pytest.raises(KeyboardInterrupt), Progress("solving", quiet=True) as progress:
            progress.update(0.5)
        Interruption.listen()
        Interruption.check()
    finally:
        for number, handler in zip(
            (signal.SIGINT, signal.SIGTERM, signal.SIGHUP), before, strict=True
        ):
            signal.signal(number, handler)


def test_progress_tells_the_time_left_once_it_knows(monkeypatch):
    clock = iter([0.0, 0.0, 10.0, 20.0, 40.0, 41.0, 47.0])
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    stream = io.StringIO()
    with Progress("solving", stream=stream) as progress:
        for done in (0.05, 0.5, 1.0):
            progress.update(done, "on the way")
        # What still goes on when all is done is told as seldom as before.
        progress.update(1.0, "polishing")
        progress.update(1.0, "still polishing")
    assert stream.getvalue().splitlines() == [
        "solving   5% · on the way",
        "solving  50% · on the way · 20 s left",
        "solving 100% · on the way · 40 s",
        "solving 100% · still polishing · 47 s",
    ]


def test_compilation_is_told_and_not_counted(monkeypatch):
    seconds = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: seconds[0])
    monkeypatch.setattr(time, "perf_counter", lambda: seconds[0])
    monkeypatch.setattr(compiler, "seconds", 0.0)
    stream = io.StringIO()
    with Progress("solving", stream=stream) as progress:
        began = working_time()
        for _ in range(2):
            compiler.on_start(None)
            compiler.on_start(None)  # one function needs another
            seconds[0] += 15.0
            compiler.on_end(None)
            compiler.on_end(None)
        seconds[0] += 8.0
        progress.update(0.5)
        assert working_time() - began == 8.0 and compiler.seconds == 30.0
    told, half = stream.getvalue().splitlines()
    assert told == "solving · compiling, once after an installation"
    assert half.endswith("8 s left")
    assert compiler.tell is None


def test_whole_folder_appears_at_the_end(tmp_path):
    target = tmp_path / "deep" / "run"
    with whole_folder(target, marker="report.json") as folder:
        (folder / "report.json").write_text("{}")
        assert not target.exists()
    assert [path.name for path in target.iterdir()] == ["report.json"]
    assert [path.name for path in target.parent.iterdir()] == ["run"]


def test_whole_folder_replaces_an_earlier_run(tmp_path):
    for text in ("first", "second"):
        with whole_folder(tmp_path / "run", marker="report.json") as folder:
            (folder / "report.json").write_text(text)
    assert (tmp_path / "run" / "report.json").read_text() == "second"
    assert len(list(tmp_path.iterdir())) == 1


def test_whole_folder_keeps_the_earlier_run_after_a_failure(tmp_path):
    with whole_folder(tmp_path / "run", marker="report.json") as folder:
        (folder / "report.json").write_text("first")
    with (
        pytest.raises(RuntimeError),
        whole_folder(tmp_path / "run", marker="report.json") as folder,
    ):
        (folder / "report.json").write_text("second")
        raise RuntimeError
    assert (tmp_path / "run" / "report.json").read_text() == "first"
    assert len(list(tmp_path.iterdir())) == 1


def test_whole_folder_brings_the_earlier_run_back(tmp_path, monkeypatch):
    with whole_folder(tmp_path / "run", marker="report.json") as folder:
        (folder / "report.json").write_text("first")
    rename = Path.rename

    def fails(self, target):
        if self.suffix == ".part":
            raise OSError("no room")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fails)
    with (
        pytest.raises(OSError, match="no room"),
        whole_folder(tmp_path / "run", marker="report.json") as folder,
    ):
        (folder / "report.json").write_text("second")
    assert (tmp_path / "run" / "report.json").read_text() == "first"
    assert len(list(tmp_path.iterdir())) == 1


def test_whole_folder_follows_a_link(tmp_path):
    (tmp_path / "disk").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "disk")
    for _ in range(2):
        with whole_folder(tmp_path / "run", marker="report.json") as folder:
            (folder / "report.json").write_text("{}")
    assert (tmp_path / "run").is_symlink()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disk", "run"]
    assert [path.name for path in (tmp_path / "disk").iterdir()] == ["report.json"]


def test_whole_folder_does_not_take_away_where_one_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with (
        pytest.raises(InputError, match="where you are"),
        whole_folder(Path(), marker="report.json"),
    ):
        pass


@pytest.mark.parametrize(
    ("folder", "head"),
    [("heads/anna", "heads/anna"), ("taro", "./taro"), ("my heads/x", "'my heads/x'")],
)
def test_the_command_that_is_printed_takes_the_new_head(folder, head):
    assert use_of(Path(folder)).endswith(f"simulate smile-closed --head {head}")


def test_report_has_null_for_what_is_not_a_number(tmp_path):
    record = {"rms": math.nan, "rows": [(1.5, -math.inf)], "name": "sad"}
    write_report(tmp_path, record)
    text = (tmp_path / "report.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail) == {
        "rms": None,
        "rows": [[1.5, None]],
        "name": "sad",
    }


def test_whole_folder_keeps_what_is_read(tmp_path):
    kept = tmp_path / "run"
    (kept / "head").mkdir(parents=True)
    (kept / "report.json").write_text("{}")
    for source in (kept, kept / "head"):
        with (
            pytest.raises(InputError, match="is read and would be replaced"),
            whole_folder(kept, "report.json", sources=[source]),
        ):
            pass
    with whole_folder(kept / "new", "report.json", sources=[kept]):
        pass
    assert (kept / "head").is_dir()


def test_whole_folder_refuses_links_in_a_circle(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with (
        pytest.raises(InputError, match=r"circle|symbolic links"),
        whole_folder(tmp_path / "loop" / "run", "report.json"),
    ):
        pass


def test_whole_folder_refuses_a_place_that_is_gone(tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with pytest.raises(InputError, match="cannot be written"), whole_folder(Path("run"), "x"):
        pass


def test_whole_folder_refuses_a_file(tmp_path):
    (tmp_path / "run").write_text("a file")
    with (
        pytest.raises(InputError, match="it is a file"),
        whole_folder(tmp_path / "run", marker="report.json"),
    ):
        pass


def test_import_is_quick():
    code = (
        "import time; began = time.perf_counter(); import modiolus; import sys;"
        "print(time.perf_counter() - began);"
        "assert not {'numba', 'scipy', 'vtk', 'pyvista', 'typer'} & set(sys.modules)"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    assert float(answer.stdout) < 0.5


def test_heads_say_where_they_come_from(run, tmp_path):
    # Long lists are counted.
    shown = run("heads")[1].partition("\ntaro\n")
    assert "  given    skin\n" in shown[0]
    assert " parts\n  inferred orbicularis_oculi_malar, eye" in shown[2]
    code, out, _ = run("heads", "--json")
    found = {head["name"]: head for head in json.loads(out)["heads"]}
    assert code == 0 and {"taro", "ict"} <= set(found)
    assert all(head["licence"] and head["source"] for head in found.values())
    local = tmp_path / "heads" / "mine"
    local.mkdir(parents=True)
    (local / "head.toml").write_text('format = 1\nname = "mine"\nmidplane = 0.0\n[landmarks]\n')
    code, out, _ = run("heads", tmp_path / "heads")
    assert code == 0 and str(local) in out and "fit not stated" in out
    (local / "head.toml").write_text("format = ")
    assert_refused(run("heads", tmp_path / "heads"), "head.toml", "TOML")
    assert_refused(run("heads", tmp_path / "none"), "none", "no such folder")


@pytest.mark.parametrize(
    "arguments",
    [
        ("morph", "taro", "--to", "face.ply", "--out", "a b"),
        ("upright", "taro", "--out", "a b"),
        ("build", "anatomy", "--out", "a b"),
    ],
)
def test_a_name_that_makes_no_folder_is_refused_before_work_begins(run, tmp_path, arguments):
    (tmp_path / "face.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    )
    assert_refused(run(*arguments), "--out", "'a b'")
    assert not (tmp_path / "a b").exists()


def test_the_package_runs_as_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "modiolus", "simulate", "grin"], capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr.startswith("modiolus: ")
