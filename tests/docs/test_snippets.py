"""Every command and snippet of the README, the quick start and the interface page is run.

Blocks that need a robot, a recording or minutes carry `<!-- not run: reason -->`; of these, and
of all other pages, the commands are held against the options that there are.
"""

import glob
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
import warnings
from itertools import pairwise
from pathlib import Path

import pytest
import typer

from slam.cli.app import app
from slam.mapping.config import SlamConfig
from slam.online.robot_config import RobotConfig, load_robot
from slam.runs.config_file import known_keys, load_config
from tests.docs.markdown_blocks import blocks, commands

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
RUN = [ROOT / "README.md", ROOT / "docs" / "quickstart.md", ROOT / "docs" / "interface.md"]
BLOCKS = [block for page in PAGES for block in blocks(page)]
COMMAND = typer.main.get_command(app)
PLACEHOLDERS = {"...", "[RUN"}


def slam_calls(line):
    """Arguments of each `slam` command in a shell line, also inside a loop."""
    for part in re.split(r"&&|;|\|", line):
        words = shlex.split(part)
        while words and words[0] in ("do", "done", "then"):
            words = words[1:]
        if words and words[0] == "slam":
            yield words[1:]


def refused(arguments):
    """Why the command line of `slam` is wrong; None if it is not."""
    command, words = COMMAND, list(arguments)
    while subcommands := getattr(command, "commands", None):
        if not words or words[0] not in subcommands:
            return f"no command {words[:1]}"
        command = subcommands[words.pop(0)]
    options = {name for parameter in command.params for name in parameter.opts}
    options |= {name for parameter in command.params for name in parameter.secondary_opts}
    for word in words:
        if word.startswith("--") and word.split("=")[0] not in options | {"--help"}:
            return f"no option {word}"
    return None


def settings_of(arguments):
    """What `--set` names, in words."""
    pairs = pairwise(arguments)
    return [after.split("=")[0] for word, after in pairs if word == "--set" and "=" in after]


@pytest.fixture
def shell(monkeypatch):
    """The programs of this environment, and pictures without a screen."""
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")


@pytest.fixture(scope="module")
def folders():
    """Folder of each page, in which its shell blocks have run."""
    return {}


def run_line(line):
    """A `slam` command in this process, where the kernels are loaded; all else in a shell."""
    words = shlex.split(line)
    if words[0] != "slam":
        subprocess.run(["bash", "-euc", line], check=True, timeout=60)
        return
    expanded = [name for word in words[1:] for name in sorted(glob.glob(word)) or [word]]
    code = app(expanded, prog_name="slam", standalone_mode=False)
    assert code in (None, 0), f"exit code {code}: {line}"


@pytest.fixture(params=RUN, ids=lambda page: page.stem)
def page(request, folders, shell, tmp_path_factory, monkeypatch):
    """A page, in a folder that holds what its shell blocks make."""
    page = request.param
    done = page in folders
    folder = folders.setdefault(page, tmp_path_factory.mktemp(page.stem))
    monkeypatch.chdir(folder)
    if not done:
        for block in blocks(page):
            if block.language == "sh" and block.not_run is None:
                for line in commands(block.text):
                    run_line(line)
    return page


def test_shell_blocks_run_as_they_stand(page):
    assert list(Path().iterdir())


def test_python_blocks_run_as_they_stand(page):
    names = {}
    for block in blocks(page):
        if block.language == "python" and block.not_run is None:
            exec(compile(block.text, str(block), "exec"), names)


def test_the_notebook_runs_from_top_to_bottom(shell, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cells = json.loads((ROOT / "docs" / "notebook.ipynb").read_text("utf-8"))["cells"]
    names = {}
    for k, cell in enumerate(cells):
        if cell["cell_type"] == "code":
            text = "".join(cell["source"])
            with warnings.catch_warnings():  # without a screen there is nothing to show
                warnings.filterwarnings("ignore", "FigureCanvasAgg is non-interactive")
                exec(compile(text, f"cell {k}", "exec"), names)
    (axes,) = names["figure"].axes
    assert len(axes.lines) == 3
    assert len(axes.images) == 1


def test_the_notebook_holds_no_outputs():
    cells = json.loads((ROOT / "docs" / "notebook.ipynb").read_text("utf-8"))["cells"]
    assert all(not cell.get("outputs") and not cell.get("execution_count") for cell in cells)


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.language == "sh"], ids=str)
def test_commands_are_such_as_there_are(block):
    assert block.not_run != "", f"{block}: the mark gives no reason"
    for line in commands(block.text):
        for arguments in slam_calls(line):
            assert refused(arguments) is None, f"{block}: {refused(arguments)}: {line}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_within_sentences_are_such_as_there_are(page):
    text = re.sub(r"^ *```.*?^ *```", "", page.read_text("utf-8"), flags=re.M | re.S)
    for quoted in re.findall(r"`(slam [a-z][^`]*)`", text):
        words = [w for w in shlex.split(quoted)[1:] if w not in PLACEHOLDERS]
        if "COMMAND" not in words:
            assert refused(words) is None, f"{page.name}: {refused(words)}: {quoted}"


def test_settings_named_in_commands_exist():
    known = {*known_keys(SlamConfig), *known_keys(RobotConfig)}
    for block in BLOCKS:
        if block.language == "sh":
            for line in commands(block.text):
                for arguments in slam_calls(line):
                    unknown = {name for name in settings_of(arguments) if name not in known}
                    assert not unknown, f"{block}: {unknown}"


@pytest.mark.parametrize("page", [p for p in PAGES if p.name != "CHANGELOG.md"], ids=str)
def test_settings_named_in_sentences_exist(page):
    sections = "|".join(SlamConfig.model_fields)
    known = {*known_keys(SlamConfig), *known_keys(RobotConfig)}
    name = re.compile(rf"`(?:--set )?((?:{sections})\.[a-z_.]+)(?:\s?=[^`]*)?`")
    files = (".yaml", ".toml", ".json", ".tum", ".png", ".pgm", ".g2o", ".csv")
    for found in name.findall(page.read_text("utf-8")):
        assert found in known or found.endswith(files), f"{page.name} names {found}"


@pytest.mark.parametrize("block", [b for b in BLOCKS if b.language == "toml"], ids=str)
def test_configurations_load(block, tmp_path):
    file = tmp_path / "config.toml"
    file.write_text(block.text, "utf-8")
    if "port" in tomllib.loads(block.text).get("laser", {}):
        load_robot(file, [])
    else:
        load_config(file, [])


def test_all_languages_are_known():
    known = {"sh", "python", "toml", "json", "text", "udev"}
    odd = {str(block): block.language for block in BLOCKS if block.language not in known}
    assert not odd, "say what a block is: ```sh, ```text, ..."


def test_a_wrong_command_is_noticed():
    assert refused(["replay", "a.mcap", "--out", "b", "--sett", "x"]) == "no option --sett"
    assert refused(["drivers", "probes", "x"]) == "no command ['probes']"
    assert list(slam_calls("for s in 1; do slam info a; done")) == [["info", "a"]]
    assert commands("slam info \\\n  a  # what\n# nothing") == ["slam info a"]
