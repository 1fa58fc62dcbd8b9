"""The group file that a job in the virtual machine prepares, whatever the group file of the host contains."""

import pytest

from tests.vm.groups import with_group

ROOT = "root:x:0:\n"


@pytest.mark.parametrize(
    "host",
    [
        ROOT,
        ROOT + "input:x:105:\n",
        ROOT + "input:x:105:someone,other",
        "input:x:4321:\n" + ROOT,
        ROOT + "input:x:105:\ninput:x:4321:\n",
    ],
)
def test_the_group_has_the_number_once(host: str) -> None:
    lines = with_group(host, "input", 4321).splitlines()
    assert [line for line in lines if line.startswith("input:")] == ["input:x:4321:"]
    assert "root:x:0:" in lines


def test_groups_of_other_names_stay() -> None:
    host = ROOT + "input-remapper:x:4321:\nplugdev:x:46:input\n"
    assert with_group(host, "input", 4321) == host + "input:x:4321:\n"
