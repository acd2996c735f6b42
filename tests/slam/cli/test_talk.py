"""What the commands say beside their results, and how they are listed."""

import pytest
from typer.testing import CliRunner

from slam.cli import output
from slam.cli.app import COMMANDS, GROUPS, app
from slam.cli.main import main
from slam.tools.demo.demo import run_demo


@pytest.fixture(autouse=True)
def usual_talk():
    yield
    output.set_talk(quiet=False, verbose=False)


def run(*words):
    return CliRunner().invoke(app, list(words), env={"COLUMNS": "100"})


def test_the_version_is_printed_alone():
    done = run("--version")
    assert done.exit_code == 0
    assert done.stdout.startswith("sdp-slam 0.")
    assert len(done.stdout.split()) == 2


def test_every_command_is_in_one_group_of_the_help():
    words = run("--help").stdout
    for group, commands in GROUPS.items():
        assert f" {group} " in words
        assert all(f" {name} " in words for name in commands)
    assert len(COMMANDS) == sum(len(commands) for commands in GROUPS.values())


def test_quiet_leaves_the_talk_out_and_not_the_file(tmp_path):
    for option, talk in (("-q", False), ("--quiet", False), (None, True)):
        out = tmp_path / f"{option}.mcap"
        words = [option] if option else []
        done = run(*words, "simulate", "testbed-180cm", "--out", str(out))
        assert done.exit_code == 0
        assert bool(done.output) == talk
        assert out.exists()
    assert run("-q", "-v", "info", "x").exit_code == 2


@pytest.mark.parametrize(("option", "traced"), [("-v", True), ("-q", False)])
def test_verbose_shows_where_an_error_came_from(tmp_path, monkeypatch, capfd, option, traced):
    monkeypatch.setattr("sys.argv", ["slam", option, "info", str(tmp_path / "none.mcap")])
    with pytest.raises(SystemExit) as ended:
        main()
    talk = capfd.readouterr().err
    assert ended.value.code == 1
    assert ("open_file" in talk) == traced
    assert "there is no such file" in talk.splitlines()[-1]


def test_no_command_has_an_option_twice():
    import typer.main

    for name, command in typer.main.get_command(app).commands.items():
        options = [option for one in command.params for option in (*one.opts, *one.secondary_opts)]
        assert len(options) == len(set(options)), name


def test_the_demo_says_what_one_drive_proves(tmp_path, monkeypatch):
    said = []
    monkeypatch.setattr("slam.tools.demo.demo._compare", lambda out, echo, direct: "table")
    run_demo(tmp_path / "demo", said.append, direct=True)
    assert any("one drive proves nothing" in text for text in said)
