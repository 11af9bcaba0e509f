"""Plans by name: only from the folder of the configured plan, and files that are no plans are never quoted."""

import os
from pathlib import Path

import pytest

from palmd import keys
from palmd.config.two_palms import LimitsConfig
from palmd.daemon.planner import PlanFolder, plan_in
from palmd.motion.limits import MotionLimits
from palmd.yamlfile import ConfigError

LIMITS = MotionLimits.from_config(LimitsConfig(), pad_length=0.0555)
PLAN = "name: rock\nsegments:\n  - {hold_s: 1.0}\n"
FAR = "name: far\nsegments:\n  - {move: {phi1_deg: 170}, duration_s: 2.0}\n"


@pytest.fixture
def etc(tmp_path):
    """A configuration's folder with plans, and private files beside it."""
    etc = tmp_path / "etc"
    (etc / "plans" / "old").mkdir(parents=True)
    for path in (etc / "plans/rock.yaml", etc / "plans/old/rock.yaml", etc / "beside.yaml", tmp_path / "outside.yaml"):
        path.write_text(PLAN)
    (etc / "plans/far.yaml").write_text(FAR)
    (etc / "plans/link.yaml").symlink_to("rock.yaml")
    (etc / "plans/out.yaml").symlink_to("../../outside.yaml")
    (etc / "plans/way").symlink_to("..")
    (etc / "plans/round.yaml").symlink_to("round.yaml")
    os.mkfifo(etc / "plans/pipe.yaml")
    return etc


def plans(etc):
    return PlanFolder(etc / "plans", etc)


def refusal(etc, name):
    with pytest.raises(ConfigError) as caught:
        plans(etc).load(name, LIMITS, None)
    return str(caught.value)


@pytest.mark.parametrize("name", ["rock.yaml", "plans/rock.yaml", "link.yaml", "./rock.yaml", "../plans/rock.yaml"])
def test_a_plan_is_found_by_its_name_in_the_configurations_folder(etc, name):
    assert plans(etc).load(name, LIMITS, None).name == "rock"


def test_valid_plans_of_the_folder_are_listed(etc):
    (etc / "plans/key.yaml").write_text("secret: 1\n")
    assert plans(etc).names() == ["far.yaml", "link.yaml", "rock.yaml"]
    assert PlanFolder(None, etc).names() == PlanFolder(etc / "none", etc).names() == []


def test_a_plan_is_found_by_its_full_path(etc):
    assert plans(etc).load(str(etc / "plans/rock.yaml"), LIMITS, None).name == "rock"


def test_a_folder_that_is_a_symbolic_link_works(etc, tmp_path):
    (tmp_path / "current").symlink_to(etc / "plans")
    assert PlanFolder(tmp_path / "current", tmp_path).load("rock.yaml", LIMITS, None).name == "rock"


def test_an_error_in_a_plan_is_reported_with_its_place_under_the_requested_name(etc):
    one, other = refusal(etc, "far.yaml").splitlines()
    assert "far.yaml:3:5: segments.0: phi1 reaches 170°" in one
    assert "far.yaml:3:5: segments.0: phi12 = phi1 + phi2 reaches 260°" in other
    assert str(etc) not in refusal(etc, "far.yaml")


@pytest.mark.parametrize(
    "name",
    [
        "none.yaml", "/etc/passwd", "/dev/zero", "../beside.yaml", "beside.yaml", "../../outside.yaml", "out.yaml",
        "way/beside.yaml", "round.yaml", "old", "old/rock.yaml", "pipe.yaml", ".", "..", "/", "x" * 5000, "plans",
    ],
)  # fmt: skip
def test_files_outside_the_folder_are_neither_opened_nor_revealed(etc, name):
    expected = "no such file beside the configured plan; palmd ctl plan FILE sends a file from elsewhere"
    assert refusal(etc, name) == f"{name}: {expected}"


def test_without_a_configured_plan_there_are_no_named_plans(etc):
    with pytest.raises(ConfigError, match="no such file"):
        PlanFolder(None, etc).load("plans/rock.yaml", LIMITS, None)


NO_PLANS = {
    "passwords": "root:x:0:0:Charlie Root:/root:/bin/bash\nsesame:x:1000:1000::/home/sesame:/bin/sh\n",
    "settings": "password: sesame\npads: {palm1: {port: /dev/sesame}}\n",
    "a list": "- sesame\n- 0123sesame\n",
    "an alias": "a: &sesame 1\nb: *sesame\n",
    "a tag": "!sesame {a: 1}\n",
    "a broken line": "user: 'sesame\n",
    "a directive": "%sesame 1\n---\n",
    "a word twice": "sesame: 1\nsesame: 2\n",
    "bytes": "sesame\0sesame",
    "nothing": "",
}


@pytest.mark.parametrize("what", NO_PLANS)
def test_a_file_that_is_no_plan_is_not_quoted(etc, what):
    (etc / "plans/other.yaml").write_text(NO_PLANS[what])
    error = refusal(etc, "other.yaml")
    assert error == "other.yaml: is not a motion plan; palmd check reports what is wrong with a file"


def test_a_key_file_is_not_quoted(etc):
    for path in keys.make_pair(etc / "plans", "server"):
        assert (
            refusal(etc, path.name)
            == f"{path.name}: is not a motion plan; palmd check reports what is wrong with a file"
        )


def test_a_binary_file_is_not_quoted(etc):
    (etc / "plans/other.yaml").write_bytes(b"sesame\xff")
    assert "is not a motion plan" in refusal(etc, "other.yaml")


def test_errors_quote_a_text_that_the_client_has_sent():
    with pytest.raises(ConfigError) as caught:
        plan_in("name: x\nsegmets: 1\n", "mine.yaml", LIMITS, None)
    assert "mine.yaml:2:1: segmets: unknown key; did you mean segments?" in caught.value.errors
    assert plan_in(PLAN, str(Path("/nobody/here.yaml")), LIMITS, None).name == "rock"
