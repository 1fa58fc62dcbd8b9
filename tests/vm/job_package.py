"""The Debian package under a systemd and a udev of its own: `run.sh -s job_package.py`.

Installed by apt, as its documentation says, and used by a member of its group; upgraded from a version before whose
configuration was another and had been changed; configured once more; purged.
"""

from __future__ import annotations

import json
import os
import pwd
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import rig
import yaml
from job_system import CONFIG, connected, node_of, run, shown, succeeds, systemctl
from rig import check, scenario, until

ROOT = Path(__file__).parents[2]
PACKAGE = next((ROOT / "build" / "deb").glob("hapticd_*.deb"))
BEFORE = next((ROOT / "build" / "deb" / "before").glob("hapticd_*.deb"))
"""The same with a lower version and another configuration: tests/vm/test.sh makes it."""
ACCOUNTS = ("hapticd", "hapticd-web")
USER = "someone-of-the-group"
WHOLE = ("/etc", "/usr/lib/systemd", "/usr/lib/sysusers.d", "/usr/lib/tmpfiles.d", "/usr/lib/udev", "/var/lib/systemd")
LISTED = ("/run", "/usr/bin", "/usr/lib", "/usr/share", "/usr/share/doc", "/usr/share/man/man1", "/var/lib")
LISTED_TOO = ("/usr/share/bash-completion/completions", "/usr/share/python3/runtime.d", "/var/lib/dpkg/info")
KEPT_BY_OTHERS = (".pwd.lock", "passwd-", "group-", "shadow-", "gshadow-", "adduser", "ld.so.cache")
"""Backups and locks of the programs that add and remove users, and a cache of everybody's."""


def prepared() -> None:
    """A machine without a network, as the host's container is none: services may start."""
    Path("/usr/sbin/policy-rc.d").unlink(missing_ok=True)
    shutil.rmtree("/var/lib/apt/lists")
    # The processor's list of instructions is longer than what the emulator can do: apt's hashes would end by SIGILL.
    Path("/etc/gcrypt").mkdir(exist_ok=True)
    Path("/etc/gcrypt/hwf.deny").write_text("all\n")
    # The emulator takes minutes for an index of all manual pages: man-db makes none where this file is not there.
    Path("/var/lib/man-db/auto-update").unlink(missing_ok=True)
    for name in ACCOUNTS:
        run("userdel", "--force", name)
    # udev's own, which the host's container may lack; the package leaves it.
    run("groupadd", "--system", "--force", "input")
    run("useradd", "--create-home", "--shell", "/bin/sh", USER)


def apt(what: str, *words: str, answer: str = "") -> str:
    """What it wrote, which is on the host while it still runs: one that takes too long says where."""
    log = rig.OUT / f"apt-{words[0]}.log"
    with open(log, "a") as output:
        begin = output.tell()
        command = ["apt-get", "-y", "-o", "DPkg::Use-Pty=0", *words]
        done = subprocess.run(command, input=answer, stdout=output, stderr=output, text=True, check=False)
    said = log.read_text()[begin:]
    check(done.returncode == 0, what, done.returncode, said.strip()[-1500:])
    return said


def by_the_member(*words: str) -> subprocess.CompletedProcess[str]:
    """The command `hapticd` of a user's new login."""
    return run("setpriv", f"--reuid={USER}", f"--regid={USER}", "--init-groups", "hapticd", *words)


def trace() -> Iterator[str]:
    """What a package could leave."""
    for place in WHOLE:
        for folder, folders, files in os.walk(place):
            yield from (f"{folder}/{name}" for name in (*folders, *files) if name not in KEPT_BY_OTHERS)
    for place in (*LISTED, *LISTED_TOO):
        if Path(place).is_dir():
            yield from (f"{place}/{name}" for name in os.listdir(place) if name not in KEPT_BY_OTHERS)
    for file in ("passwd", "group", "shadow", "gshadow"):
        yield from (f"{file}: {line}" for line in Path("/etc", file).read_text().splitlines())
    for process in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = process.read_bytes().decode(errors="replace").split("\0")
        except (FileNotFoundError, ProcessLookupError):
            continue
        if words[0].startswith("/usr/lib/hapticd/"):
            yield f"process {' '.join(words)}"


def three_commands() -> None:
    scenario("from nothing to the first tap")
    apt("apt install ./hapticd_*.deb", "install", str(BEFORE))
    check(shown("hapticd", "ActiveState") == "active", "the service runs", shown("hapticd", "StatusText"))
    check(systemctl("is-enabled", "hapticd") == "enabled", "and will at the next start")
    seen = systemctl("is-enabled", "hapticd-web"), shown("hapticd-web", "ActiveState")
    check(seen == ("disabled", "inactive"), "hapticd-web waits for whoever enables it", *seen)
    for user in ACCOUNTS:
        check(pwd.getpwnam(user).pw_shell.endswith("nologin"), f"the user {user}", pwd.getpwnam(user))
    node = node_of(Path("/dev/cpu_dma_latency"))
    check(node == ("hapticd", "0o660"), "udev gave /dev/cpu_dma_latency to the group", node)
    succeeds("adduser", "adduser", USER, "hapticd")
    done = by_the_member("--runtime-dir", str(rig.RUNTIME), "play", "wood", "--amplitude", "20", "--json")
    check(done.returncode == 0, "hapticd play wood, by a member of the group", done.stdout, done.stderr)
    check(done.returncode == 0 and json.loads(done.stdout)["displayed_hz"] > 0, "the tap is struck")
    done = by_the_member("--runtime-dir", str(rig.RUNTIME), "status", "--json")
    check(done.returncode == 0, "hapticd status, by a member of the group", done.stderr)
    realtime: Any = json.loads(done.stdout)["realtime"]
    check(
        not realtime["missing"] and realtime["idle_states_held"], "real time is granted from the first start", realtime
    )
    outsider = run(
        "setpriv",
        "--reuid=nobody",
        "--regid=nogroup",
        "--clear-groups",
        "hapticd",
        "--runtime-dir",
        str(rig.RUNTIME),
        "status",
    )
    check(outsider.returncode == 1, "nobody else may", outsider.stderr.strip())


def served() -> None:
    scenario("the page's service")
    succeeds("enable --now", "systemctl", "enable", "--now", "hapticd-web")
    check(shown("hapticd-web", "ActiveState") == "active", "active", shown("hapticd-web", "StatusText"))


def upgraded() -> None:
    scenario("upgrade")
    old = CONFIG.read_text()
    mine: dict[str, Any] = yaml.safe_load(old)
    mine["scene"]["objects"]["mine"] = {"kind": "viscous", "damping_n_s_per_m": 0.5}
    changed = "# Changed by hand.\n" + yaml.safe_dump(mine)
    CONFIG.write_text(changed)
    pids = {unit: shown(unit, "MainPID") for unit in ("hapticd", "hapticd-web")}
    apt("apt install of the newer one, the question answered by its default", "install", str(PACKAGE), answer="\n")
    check(CONFIG.read_text() == changed, "the changed configuration is kept")
    new = CONFIG.with_name("config.yaml.dpkg-dist")
    check(new.exists() and new.read_text() != old, "the new one is beside it")
    for unit, pid in pids.items():
        check(shown(unit, "ActiveState") == "active" and shown(unit, "MainPID") != pid, f"{unit} is started again")
    with connected() as client:
        answer: Any = client.get_scene()
    check("mine" in answer["scene"]["objects"], "with it", sorted(answer["scene"]["objects"]))
    version = run("hapticd", "--version").stdout.strip()
    check(version.split()[-1] in PACKAGE.name, "the new version", version, PACKAGE.name)


def configured_again() -> None:
    scenario("the maintainer scripts once more")
    for words in (("postinst", "configure", ""), ("postinst", "abort-upgrade", "0"), ("prerm", "upgrade", "9")):
        # Its helpers do nothing but for dpkg.
        script = f"/var/lib/dpkg/info/hapticd.{words[0]}"
        done = run("env", "DPKG_MAINTSCRIPT_PACKAGE=hapticd", script, *words[1:])
        check(
            (done.returncode, done.stdout, done.stderr) == (0, "", ""),
            f"{' '.join(words)}: nothing said",
            done.returncode,
            done.stdout + done.stderr,
        )
    check(bool(until(lambda: shown("hapticd", "ActiveState") == "active", 60, 0.5)), "active")


def purged(before: set[str]) -> None:
    scenario("purge")
    # pip adds the packages of other extras here; dpkg does not know them.
    Path("/usr/lib/hapticd/added_by_pip.py").touch()
    apt("apt remove", "remove", "hapticd")
    check(CONFIG.exists() and shown("hapticd", "ActiveState") != "active", "the configuration stays, no service")
    web = shown("hapticd-web", "ActiveState")
    check(web != "active", "neither the page's", web)
    apt("apt purge", "purge", "hapticd")
    after = set(trace())
    check(not after - before, "nothing is left", sorted(after - before)[:20])
    check(not before - after, "nothing else is gone", sorted(before - after)[:20])


def main() -> None:
    prepared()
    before = set(trace())
    three_commands()
    served()
    upgraded()
    configured_again()
    purged(before)
    rig.done()


if __name__ == "__main__":
    try:
        main()
    finally:
        (rig.OUT / "journal.log").write_text(run("journalctl", "--no-pager", "-o", "short-monotonic").stdout)
