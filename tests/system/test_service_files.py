"""`hapticd install-service` into folders of its own, and what systemd itself says of the units."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from hapticd.base.errors import HapticdError
from hapticd.cli import main
from hapticd.config.configuration import default_config, load_config
from hapticd.system.paths import SYSTEM_DIRECTORY
from hapticd.system.rooted_files import Rooted
from hapticd.system.service_files import Installation, Service, unit_word
from tests.support.special_files import KINDS, special, untouched

ROOT = Path(__file__).parents[2]
HERE = Installation(Path("/opt/hapticd/bin/hapticd"), (Path("/opt/hapticd"),))
UNITS = ("hapticd.service", "hapticd-web.service")
FILES = {
    "etc/systemd/system/hapticd.service",
    "etc/systemd/system/hapticd-web.service",
    "etc/sysusers.d/hapticd.conf",
    "etc/tmpfiles.d/hapticd.conf",
    "etc/udev/rules.d/70-hapticd.rules",
    "etc/udev/rules.d/70-hapticd-idle.rules",
    "etc/hapticd/config.yaml",
}


class System:
    """A root, and commands that are only written down."""

    def __init__(self, root: Path, installation: Installation = HERE) -> None:
        self.root, self.installation = root, installation
        self.commands: list[list[str]] = []
        self.problem: str | None = None

    def service(self, **keys: bool) -> Service:
        return Service(self.installation, root=self.root, run=self.run, **keys)

    def run(self, words: Sequence[str]) -> str | None:
        self.commands.append(list(words))
        return self.problem

    def install(self) -> dict[str, str]:
        """What was done to each path."""
        return self.told(self.service().install())

    def uninstall(self) -> dict[str, str]:
        return self.told(self.service().uninstall())

    def told(self, steps: object) -> dict[str, str]:
        assert isinstance(steps, object)
        found = {}
        for step in list(steps):  # type: ignore[call-overload]
            if step.what.startswith(str(self.root)):
                found[os.path.relpath(step.what, self.root)] = step.kind
        return found

    def files(self) -> set[str]:
        return {str(path.relative_to(self.root)) for path in self.root.rglob("*") if path.is_file()}

    def text(self, name: str) -> str:
        return (self.root / name).read_text()


@pytest.fixture
def system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> System:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    return System(tmp_path)


# ---- Files -----------------------------------------------------------------------------------------------------------


def test_everything_is_put_in_place_and_told(system: System) -> None:
    assert system.install() == dict.fromkeys(FILES, "wrote")
    assert system.files() == FILES
    for name in FILES:
        assert os.stat(system.root / name).st_mode & 0o777 == 0o644
    unit = system.text("etc/systemd/system/hapticd.service")
    assert "ExecStart=/opt/hapticd/bin/hapticd run -c /etc/hapticd/config.yaml\n" in unit
    assert "ExecStopPost=/opt/hapticd/bin/hapticd stop-device\n" in unit
    assert "/usr/bin/hapticd" not in unit
    assert load_config([system.root / "etc/hapticd/config.yaml"]) == default_config()


def test_again_nothing_changes(system: System) -> None:
    system.install()
    before = {name: system.text(name) for name in FILES}
    assert system.install() == dict.fromkeys(FILES, "unchanged")
    assert {name: system.text(name) for name in FILES} == before


def test_of_another_installation_it_is_updated(system: System) -> None:
    system.install()
    system.installation = Installation(Path("/usr/local/bin/hapticd"), ())
    told = system.install()
    assert {name for name, kind in told.items() if kind == "updated"} == {f"etc/systemd/system/{n}" for n in UNITS}
    assert "ExecStart=/usr/local/bin/hapticd run" in system.text("etc/systemd/system/hapticd.service")


def test_what_somebody_changed_is_kept(system: System) -> None:
    system.install()
    unit, config = "etc/systemd/system/hapticd.service", "etc/hapticd/config.yaml"
    for name in (unit, config):
        (system.root / name).write_text(system.text(name).replace("hid", "HID") + "# mine\n")
    mine = {name: system.text(name) for name in (unit, config)}
    system.installation = Installation(Path("/usr/local/bin/hapticd"), ())
    told = system.install()
    assert told[unit] == "kept" and told[config] == "kept"
    assert {name: system.text(name) for name in (unit, config)} == mine
    assert "ExecStart=/usr/local/bin/hapticd run" in system.text(unit + ".new")


def test_a_changed_file_whose_original_is_the_same_as_now_gets_no_new_one(system: System) -> None:
    system.install()
    config = system.root / "etc/hapticd/config.yaml"
    config.write_text(config.read_text().replace("start_m: [0, 0.01]", "start_m: [0, 0.02]"))
    assert system.install()["etc/hapticd/config.yaml"] == "kept"
    assert system.files() == FILES


def test_lines_behind_the_checksum_do_not_hide_what_a_file_was_made_from(system: System) -> None:
    system.install()
    config = system.root / "etc/hapticd/config.yaml"
    mine = config.read_text() + "flight: {keep: 3}\n"
    config.write_text(mine)
    assert system.install()["etc/hapticd/config.yaml"] == "kept"
    assert system.files() == FILES
    assert system.uninstall()["etc/hapticd/config.yaml"] == "kept"
    assert config.read_text() == mine


def test_clients_are_told_the_directory_of_the_units() -> None:
    daemon, page = ((ROOT / "systemd" / name).read_text() for name in UNITS)
    assert f"\nRuntimeDirectory={SYSTEM_DIRECTORY.relative_to('/run')}\n" in daemon
    assert f" --runtime-dir {SYSTEM_DIRECTORY} web\n" in page


@pytest.mark.parametrize("name", [*UNITS, "hapticd.user.service"])
def test_a_service_that_cannot_start_is_never_given_up(name: str) -> None:
    """systemd gives up after StartLimitBurst starts within StartLimitIntervalSec."""
    unit = dict(line.split("=", 1) for line in (ROOT / "systemd" / name).read_text().splitlines() if "=" in line)
    assert unit["Restart"] == "on-failure"
    assert float(unit["StartLimitIntervalSec"]) / float(unit["RestartSec"]) < float(unit["StartLimitBurst"])


def test_what_a_package_has_put_in_place_is_not_repeated(system: System) -> None:
    """As the Debian package does: the units' own paths, below /usr/lib, unsigned, and a configuration of its own."""
    system.installation = replace(HERE, executable=Path("/usr/bin/hapticd"), folders=(Path("/usr"),))
    brought = {name.replace("etc/", "usr/lib/", 1): ROOT / "systemd" / name.rpartition("/")[2] for name in FILES}
    brought["usr/lib/sysusers.d/hapticd.conf"] = ROOT / "systemd" / "sysusers.conf"
    brought["usr/lib/tmpfiles.d/hapticd.conf"] = ROOT / "systemd" / "tmpfiles.conf"
    del brought["usr/lib/hapticd/config.yaml"]
    for name, source in (*brought.items(), ("etc/hapticd/config.yaml", ROOT / "config" / "default.yaml")):
        (system.root / name).parent.mkdir(parents=True, exist_ok=True)
        (system.root / name).write_text(source.read_text())
    before = system.files()
    assert system.install() == dict.fromkeys((*brought, "etc/hapticd/config.yaml"), "unchanged")
    assert system.files() == before
    assert set(system.uninstall().values()) == {"absent", "kept"}
    assert system.files() == before
    other = system.root / "usr/lib/tmpfiles.d/hapticd.conf"
    other.write_text("d /etc/hapticd 0700 root root -\n")
    assert system.install()["etc/tmpfiles.d/hapticd.conf"] == "wrote"


@pytest.mark.parametrize("what", ["link", "binary", "unsigned"])
def test_what_is_not_ours_is_never_overwritten(system: System, what: str) -> None:
    path = system.root / "etc/systemd/system/hapticd.service"
    path.parent.mkdir(parents=True)
    if what == "link":
        path.symlink_to("/dev/null")  # as `systemctl mask` does
    else:
        path.write_bytes(b"\xff\xfe" if what == "binary" else b"[Service]\n")
    assert system.install()["etc/systemd/system/hapticd.service"] == "kept"
    assert path.is_symlink() if what == "link" else path.read_bytes()[:2] in (b"\xff\xfe", b"[S")
    assert system.uninstall()["etc/systemd/system/hapticd.service"] == "kept"
    assert os.path.lexists(path)


def test_uninstall(system: System) -> None:
    system.install()
    rule = system.root / "etc/udev/rules.d/70-hapticd.rules"
    rule.write_text(rule.read_text() + "# mine\n")
    told = system.uninstall()
    assert told == {name: "removed" for name in FILES} | {"etc/udev/rules.d/70-hapticd.rules": "kept"}
    assert system.files() == {"etc/udev/rules.d/70-hapticd.rules"}
    assert set(system.uninstall().values()) == {"absent", "kept"}


def test_uninstall_takes_the_new_one_away_too(system: System) -> None:
    unit = system.root / "etc/systemd/system/hapticd.service"
    unit.parent.mkdir(parents=True)
    unit.write_text("[Service]\n")
    system.install()
    assert unit.with_name("hapticd.service.new").exists()
    system.uninstall()
    assert system.files() == {"etc/systemd/system/hapticd.service"}


def test_dry_run_changes_nothing(system: System) -> None:
    steps = list(system.service(dry_run=True).install())
    assert {step.kind for step in steps} <= {"wrote", "ran", "note"}
    assert system.files() == set() and system.commands == []
    system.install()
    before = len(system.commands)
    assert "removed" in {step.kind for step in system.service(dry_run=True).uninstall()}
    assert system.files() == FILES and len(system.commands) == before


def test_another_root_does_not_touch_the_running_system(system: System) -> None:
    system.install()
    assert {words[0] for words in system.commands} <= {"systemd-sysusers", "systemd-tmpfiles"}
    assert all(f"--root={system.root}" in words for words in system.commands)


def test_a_command_that_fails_is_told(system: System) -> None:
    system.problem = "no such group"
    steps = [step for step in system.service().install() if step.kind == "failed"]
    assert len(steps) == len(system.commands)
    assert all(step.detail == "no such group" for step in steps)


def test_for_one_user(tmp_path: Path) -> None:
    commands: list[Sequence[str]] = []
    (tmp_path / "booted").mkdir()

    def run(words: Sequence[str]) -> None:
        commands.append(words)

    service = Service(HERE, user=True, config_home=tmp_path / "home", run=run, booted=tmp_path / "booted")
    written = [Path(step.what) for step in service.install() if step.kind == "wrote"]
    assert written == [tmp_path / "home/systemd/user/hapticd.service", tmp_path / "home/hapticd/config.yaml"]
    unit = written[0].read_text()
    assert "ExecStart=/opt/hapticd/bin/hapticd run -c %E/hapticd/config.yaml\n" in unit
    assert "User=" not in unit and "multi-user.target" not in unit
    assert all(words[:2] == ["systemctl", "--user"] for words in commands)
    assert [step.kind for step in service.uninstall() if step.what.startswith(str(tmp_path))] == ["removed"] * 2


# ---- Another root, and systems without systemd or udev ---------------------------------------------------------------


@pytest.mark.parametrize("inner", ["etc", "etc/systemd", "etc/hapticd"])
@pytest.mark.parametrize("done", ["install", "dry run", "uninstall"])
def test_no_link_leads_out_of_another_root(system: System, tmp_path: Path, inner: str, done: str) -> None:
    outside = tmp_path.parent / f"{tmp_path.name}-outside"
    if done == "uninstall":
        system.install()
        (system.root / inner).rename(outside)
    else:
        outside.mkdir()
        (system.root / inner).parent.mkdir(parents=True, exist_ok=True)
    (system.root / inner).symlink_to(outside)
    before = {path: path.stat().st_mtime_ns for path in outside.rglob("*")}
    service = system.service(dry_run=done == "dry run")
    ran = len(system.commands)
    with pytest.raises(HapticdError) as told:
        list(service.uninstall() if done == "uninstall" else service.install())
    assert str(told.value) == f"{system.root / inner}: is a symbolic link; below --root it must be a folder"
    assert {path: path.stat().st_mtime_ns for path in outside.rglob("*")} == before
    assert len(system.commands) == ran


def test_a_link_that_is_put_there_meanwhile_is_not_followed(system: System, tmp_path: Path) -> None:
    outside = tmp_path.parent / f"{tmp_path.name}-outside"
    outside.mkdir()
    steps = system.service().install()
    assert next(steps).kind == "wrote"
    (system.root / "etc" / "sysusers.d").symlink_to(outside)
    with pytest.raises(HapticdError, match="is a symbolic link"):
        list(steps)
    assert not any(outside.iterdir())


def test_the_root_itself_may_be_named_by_a_link(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    System(tmp_path / "link").install()
    assert System(tmp_path / "real").files() == FILES


def test_folders_can_be_entered_and_files_be_read_whatever_the_umask(system: System) -> None:
    before = os.umask(0o177)
    try:
        system.install()
    finally:
        os.umask(before)
    assert {path.stat().st_mode & 0o777 for path in system.root.rglob("*") if path.is_dir()} == {0o755}
    modes = {path: path.stat().st_mode & 0o777 for path in system.root.rglob("*") if path.is_file()}
    assert modes and set(modes.values()) == {0o644}, modes


@pytest.mark.parametrize("udev", [False, True])
@pytest.mark.parametrize("booted", [False, True])
def test_uninstall_asks_of_the_system_only_what_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, udev: bool, booted: bool
) -> None:
    """The running system's `/` stands in a folder here."""
    monkeypatch.setattr("shutil.which", lambda name: f"/usr/bin/{name}")
    runs = tmp_path / "runs"
    runs.mkdir()
    ran: list[list[str]] = []

    service = Service(
        HERE,
        run=lambda words: ran.append(list(words)),
        booted=runs if booted else tmp_path / "none",
        udev=runs if udev else tmp_path / "none",
    )
    targets = service._targets()
    monkeypatch.setattr(
        service,
        "_targets",
        lambda: [replace(target, path=tmp_path / target.path.relative_to("/")) for target in targets],
    )
    assert "failed" not in {step.kind for step in service.install()}
    ran.clear()
    steps = list(service.uninstall())
    assert [step.kind for step in steps].count("removed") == len(FILES)
    assert (["udevadm", "control", "--reload"] in ran) == udev
    assert (["systemctl", "disable", "--now", *UNITS] in ran) == (["systemctl", "daemon-reload"] in ran) == booted
    told = f"systemd does not run here, so no service is stopped: {', '.join(UNITS)}"
    assert (told in [step.what for step in steps]) == (not booted)


# ---- Paths -----------------------------------------------------------------------------------------------------------


def test_an_installation_in_a_home_is_let_into_the_sandbox_and_nothing_else_of_it(tmp_path: Path) -> None:
    home = Installation(Path("/home/ann/h 1/bin/hapticd"), (Path("/home/ann/h 1"), Path("/opt/python")))
    system = System(tmp_path, home)
    system.install()
    for name in UNITS:
        unit = system.text(f"etc/systemd/system/{name}")
        assert "\nProtectHome=tmpfs\n" in unit and "ProtectHome=yes" not in unit
        assert '\nBindReadOnlyPaths="/home/ann/h 1"\n' in unit
        assert "/opt/python" not in unit
        assert 'ExecStart="/home/ann/h 1/bin/hapticd" ' in unit


def test_an_installation_below_tmp_is_warned_of(tmp_path: Path) -> None:
    system = System(tmp_path, Installation(Path("/tmp/v/bin/hapticd"), (Path("/tmp/v"),)))
    notes = [step.what for step in system.service().install() if step.kind == "note"]
    assert any("/tmp/v may be emptied" in note for note in notes)
    assert "\nBindReadOnlyPaths=/tmp/v\n" in system.text("etc/systemd/system/hapticd.service")


@pytest.mark.parametrize(
    ("path", "word"), [("/a/b", "/a/b"), ("/a/b c", '"/a/b c"'), ("/a/50%", "/a/50%%"), ("/a/é", "/a/é")]
)
def test_words_of_a_unit_file(path: str, word: str) -> None:
    assert unit_word(Path(path)) == word


@pytest.mark.parametrize("path", ["/a/$x", "/a:b", "/a/;", "/a'b", '/a"b', "/a\\b", "/a\nb"])
def test_paths_that_a_unit_file_cannot_name_are_refused(path: str) -> None:
    with pytest.raises(HapticdError, match="install hapticd elsewhere"):
        unit_word(Path(path))


def test_this_installation_is_found_or_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysconfig.get_path", lambda name: str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["python"])
    beside = Path(sys.executable).parent / "hapticd"
    if not beside.exists():
        with pytest.raises(HapticdError, match="no executable `hapticd` in "):
            Installation.this()
    (tmp_path / "hapticd").write_text("#!/bin/sh\n")
    (tmp_path / "hapticd").chmod(0o755)
    found = Installation.this()
    assert found.executable == (beside if beside.exists() else tmp_path / "hapticd")
    assert any(ROOT.is_relative_to(folder) for folder in found.folders)
    assert not any(one != two and one.is_relative_to(two) for one in found.folders for two in found.folders)


# ---- The command -----------------------------------------------------------------------------------------------------


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A root, and an installation to put into it."""
    script = tmp_path / "bin" / "hapticd"
    script.parent.mkdir()
    script.write_text("#!/bin/sh\n")
    script.chmod(0o755)
    monkeypatch.setattr(Installation, "this", staticmethod(lambda: Installation(script, (tmp_path / "bin",))))
    (tmp_path / "root").mkdir()
    return tmp_path / "root"


def test_the_command(installed: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["install-service", "--root", str(installed), "--dry-run"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert f"would write {installed}/etc/hapticd/config.yaml\n" in captured.out
    assert not any(installed.iterdir())
    assert main(["install-service", "--root", str(installed), "--json"]) == 0
    steps = json.loads(capsys.readouterr().out)
    written = {os.path.relpath(step["what"], installed) for step in steps if step["kind"] == "wrote"}
    assert written == FILES
    assert main(["install-service", "--root", str(installed), "--uninstall"]) == 0
    assert f"removed {installed}/etc/hapticd/config.yaml\n" in capsys.readouterr().out
    fresh = installed / "made" / "anew"
    assert main(["install-service", "--root", str(fresh), "--json"]) == 0
    capsys.readouterr()
    assert (fresh / "etc/hapticd/config.yaml").exists()
    assert main(["install-service", "--root", str(installed), "--user"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_packager_without_root_gets_every_file(
    installed: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr("hapticd.system.service_files._run", lambda words: "fchownat() failed: Operation not permitted")
    assert main(["install-service", "--root", str(installed)]) == 0
    assert {str(path.relative_to(installed)) for path in installed.rglob("*") if path.is_file()} == FILES
    lines = capsys.readouterr().out.splitlines()
    assert lines[-1] == (
        "`systemd-sysusers hapticd.conf` and `systemd-tmpfiles --create hapticd.conf` need root: "
        "left to whoever installs the package"
    )
    assert sum(line.startswith("wrote ") for line in lines) == len(FILES)


def test_without_rights_nothing_is_written(system: System) -> None:
    service = Service(HERE, root=system.root, run=system.run, may_write=lambda folder: False)
    for steps in (service.install, service.uninstall):
        if steps == service.uninstall:
            system.install()
        with pytest.raises(
            HapticdError, match=r"no permission to write into .*; run it as root, or .* with --user"
        ) as told:
            list(steps())
        assert "\n" not in str(told.value)
    assert system.files() == FILES


# ---- The package -----------------------------------------------------------------------------------------------------


def test_the_package_carries_every_file() -> None:
    import tomllib

    data = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["hapticd"]
    matched = {path.name for pattern in data for path in (ROOT / "hapticd").glob(pattern) if "units" in pattern}
    assert matched == set(os.listdir(ROOT / "systemd"))


# ---- systemd's own word ----------------------------------------------------------------------------------------------

analyze = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze")


@analyze
@pytest.mark.parametrize("home", [False, True])
def test_the_units_are_valid(tmp_path: Path, home: bool) -> None:
    """In a root that has systemd's own units, the users and an executable."""
    executable = Path("/home/ann/v 1/bin/hapticd") if home else Path("/opt/hapticd/bin/hapticd")
    system = System(tmp_path, Installation(executable, (executable.parents[1],)))
    system.install()
    for program in (tmp_path / executable.relative_to("/"), tmp_path / "bin" / "kill"):
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
    (tmp_path / "usr/lib/systemd").mkdir(parents=True)
    places = [Path(place) for place in ("/usr/lib/systemd/system", "/lib/systemd/system")]
    shutil.copytree(
        next(place for place in places if place.exists()), tmp_path / "usr/lib/systemd/system", symlinks=True
    )
    words = ["systemd-analyze", "verify", f"--root={tmp_path}", *UNITS]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    said = [line for line in done.stderr.splitlines() if "hapticd" in line]
    assert (done.returncode, said) == (0, [])


@analyze
@pytest.mark.parametrize(("name", "most"), [("hapticd.service", 1.0), ("hapticd-web.service", 1.6)])
def test_the_units_are_exposed_as_little_as_promised(name: str, most: float) -> None:
    path = str(ROOT / "systemd" / name)
    words = ["systemd-analyze", "security", "--offline=true", f"--threshold={round(10 * most)}", "--no-pager", path]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout[-500:] + done.stderr
    (line,) = [line for line in done.stdout.splitlines() if "Overall exposure level" in line]
    exposure = float(line.split(":")[1].split()[0])
    assert exposure <= most
    # The page says the same.
    page = (ROOT / "docs" / "service.md").read_text()
    assert f"| `{name}` | {exposure:g} |" in page


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_regular_file_stays(kind: str, tmp_path: Path) -> None:
    place = tmp_path / "etc" / "unit.service"
    place.parent.mkdir()
    special(place, kind)
    with untouched(tmp_path), pytest.raises(HapticdError, match=r"unit\.service: cannot be written: File exists"):
        Rooted(tmp_path).write(place, "text")
