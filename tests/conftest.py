"""Set up for every test: nothing random from run to run in CI, no window, nothing that depends on load, nothing of the
shell that it was started from.
"""

import gc
import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from importlib import resources

import pytest
from hypothesis import HealthCheck, settings

# Before anything imports matplotlib.
os.environ["MPLBACKEND"] = "Agg"

# What the user set for the commands is not for the tests. These are: see tests/web/browser.py and
# tests/integration/test_other_languages.py.
_FOR_TESTS = ("HAPTICD_BROWSER", "HAPTICD_CLIENTS")
for _name in [name for name in os.environ if name.startswith("HAPTICD_") and name not in _FOR_TESTS]:
    del os.environ[_name]

# A job that a script put in the background ignores interrupts, and one under nohup the end of its terminal. Every
# process that a test starts would inherit that, and the test that interrupts it would wait for ever.
for _number, _handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(_number) is signal.SIG_IGN:
        signal.signal(_number, _handler)

# Deadlines and `too_slow` would test the machine's load. CI repeats its examples, others try new ones.
_CALM = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("local", _CALM)
settings.register_profile("ci", _CALM, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "local")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Short names for the tests' folders: a socket's name has at most 107 bytes, however long the user's name is."""
    if config.option.basetemp is None and not hasattr(config, "workerinput"):
        base = tempfile.mkdtemp(prefix="ht-")
        config.option.basetemp = base
        config.add_cleanup(lambda: shutil.rmtree(base, ignore_errors=True))


def pytest_collection_finish() -> None:
    """What thousands of tests are made of stays. A collection that went through all of it would hold up every thread of
    Python for longer than a device of this process may be late."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True, scope="session")
def _neither_the_users_configuration_nor_an_installed_service(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[None]:
    """A process that a test starts takes the built-in configuration, too, whatever stands in /etc/hapticd: a copy of it
    is the user's."""
    none, home = tmp_path_factory.mktemp("none"), tmp_path_factory.mktemp("config")
    built_in = resources.files("hapticd").joinpath("shipped", "default.yaml").read_text(encoding="utf-8")
    (home / "hapticd").mkdir()
    (home / "hapticd" / "config.yaml").write_text(built_in, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(home))
        patch.setattr("hapticd.config.locations.SYSTEM_CONFIG", none / "config.yaml")
        for module in ("hapticd.system.paths", "hapticd.protocol.places"):
            patch.setattr(f"{module}.SYSTEM_DIRECTORY", none / "run")
        yield


@pytest.fixture(autouse=True, scope="session")
def _a_servo_of_this_process_may_be_held_up() -> Iterator[None]:
    """A command waits for the servo's thread until it comes to run; the bound only keeps a broken test from hanging."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hapticd.daemon.command_ring.COMMAND_TIMEOUT_S", 60.0)
        yield
