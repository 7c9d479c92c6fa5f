"""The error model: read, checked, and never dropped in silence."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import viatool
from viatool.errors import ConfigurationError
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.uncertainty import ErrorModel, as_error_model, load_errors
from viatool.uncertainty.supported import SUPPORTED

EVERY_TERM = """
sensor:
  lidar: {absolute: 0.03, relative: 0.01, bias: 0.02, angle: 0.01, missing: 2, thin: 0.02}
pose: {x: 0.02, y: 0.02, theta: 0.01}
start: {x: 0.1, y: 0.1, theta: 0.05}
actuation:
  linear: {acceleration: 1.0, deceleration: 1.5, lag: [0.05, 0.15], relative: 0.05, absolute: 0.01}
  lateral: {acceleration: 1.0}
  angular: {acceleration: 3.0}
  slip: 0.05
timing: {interval: [0.09, 0.12], delay: [0.05, 0.1], sensing: 0.1}
obstacles:
  {speed: 1.2, named: {crate: 0.4}, roams: {chair: 0.5}, returns: 1.2, people: 1.2, hidden: 1.2, behind: 1.0}
"""


@pytest.fixture(scope="module")
def policy():
    return viatool.load_policy("via")


@pytest.fixture(scope="module")
def lab():
    return viatool.load_map("lab")


def written(tmp_path, text):
    path = tmp_path / "robot-errors.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_term_is_read_and_stated_with_its_unit(tmp_path):
    model = load_errors(written(tmp_path, EVERY_TERM))
    told = dict(model.premises())
    assert told["sensor.lidar.bias"] == "0.02 the channel's unit"
    assert told["actuation.linear.lag"] == "0.05 to 0.15 s"
    assert told["obstacles.named.crate"] == "0.4 m/s"
    assert told["actuation.linear.acceleration"] == "1 m/s^2"
    assert told["actuation.angular.acceleration"] == "3 rad/s^2"
    assert len(told) == 30
    assert model.assumed() == {}


def test_an_empty_section_states_nothing_and_assumes_an_ideal_robot(tmp_path):
    model = load_errors(written(tmp_path, "actuation:\n"))
    assert not model
    assert "obstacles do not move" in model.assumed()["moving things"]
    assert load_errors(written(tmp_path, "sensor: {lidar: {bias: 0.0}}"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("timing: {interval: [0.0, 0.1]}", "timing.interval[0]: input should be greater than 0"),
        (
            "actuation: {linear: {acceleration: 0}}",
            "linear.acceleration: input should be greater than 0, got 0",
        ),
        (
            "actuation: {linear: {acceleration: [2, 1]}}",
            "linear.acceleration: the lower end 2 is above the upper end 1",
        ),
        ("actuation: {linear: {acceleration: yes}}", "linear.acceleration: yes is not a number"),
        ("actuation: {linear: {relative: no}}", "linear.relative: no is not a number"),
        ("sensor: {lidar: {missing: yes}}", "sensor.lidar.missing: yes is not a number"),
        ("sensor: {lidar: {angle: yes}}", "sensor.lidar.angle: yes is not a number"),
        ("sensor: {lidar: {absolute: -0.1}}", "robot-errors.yaml:1: sensor.lidar.absolute"),
        ("timing: {delay: [0.2, 0.1]}", "lower end 0.2 is above the upper end 0.1"),
        ("timing:\n  delays: [0.1, 0.2]", "robot-errors.yaml:2: timing.delays: is not a known field"),
        ("actuation: {linear: {acceleration: .nan}}", "actuation.linear.acceleration"),
        ("obstacles: {speed: .inf}", "obstacles.speed"),
        ("obstacles: {people: yes}", "yes is not a number"),
        ("- a", "robot-errors.yaml:1: expected a mapping"),
        ("", "robot-errors.yaml: is empty"),
        ("# absolute: 0.1\n", "robot-errors.yaml: is empty"),
        ("sensor:\n  lidar:\n    absolute:\n", "robot-errors.yaml:3: sensor.lidar.absolute: has no number"),
        ("sensor:\n\tlidar: {}", "hint: indent with spaces"),
        (
            "pose: {x: 0.1}\npose: {x: 0.2}",
            "robot-errors.yaml:2: 'pose' appears twice in one mapping\nhint: remove",
        ),
        ("sensors: {}", "sensors: is not a known field, which are version, sensor, pose, start, actuation"),
        ("sensor: {lidar: {abs: 1}}", "abs: is not a known field, which are absolute, relative, bias"),
        ("timing: {interval: 0.1}", "timing.interval: expected two numbers, the least and the largest"),
        ("timing: {delay: [0.1, 0.2, 0.3]}", "timing.delay: expected two numbers"),
        ("obstacles: {named: [crate]}", "obstacles.named: expected a mapping"),
    ],
)
def test_what_is_wrong_is_named_with_file_and_field(tmp_path, text, said):
    with pytest.raises(ConfigurationError) as caught:
        load_errors(written(tmp_path, text))
    assert said in str(caught.value)


def test_what_is_no_error_model_is_refused_with_a_way_to_write_one():
    with pytest.raises(ConfigurationError, match="errors is of type dict"):
        as_error_model({"pose": {"x": 0.1}})


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match=r"none\.yaml.*cannot be read"):
        load_errors(tmp_path / "none.yaml")


def test_absolute_errors_are_the_radii_of_their_channels(policy, lab):
    model = ErrorModel.model_validate({"sensor": {"lidar": {"absolute": 0.03}}})
    told = Setting.of(policy, lab, 0.01, Wishes(errors=model), job="verify")
    same = Setting.of(policy, lab, {"": 0.01, "lidar": 0.03})
    np.testing.assert_array_equal(told.radii, same.radii)
    assert told.errors.sources["lidar"] == "the error model"
    with pytest.raises(ConfigurationError, match="contradicts"):
        Setting.of(policy, lab, {"": 0.01, "lidar": 0.02}, Wishes(errors=model), job="verify")


def test_a_channel_that_the_policy_lacks_is_refused(policy, lab):
    model = ErrorModel.model_validate({"sensor": {"radar": {"absolute": 0.03}}})
    with pytest.raises(ConfigurationError, match=r"the error model: sensor\.radar: there is no"):
        Setting.of(policy, lab, 0.01, Wishes(errors=model), job="verify")


@pytest.mark.parametrize("delay", [[0.05, 0.1], [0.1, 0.1]])
def test_a_delay_that_the_model_states_is_said_to_come_from_it(policy, lab, delay):
    model = ErrorModel.model_validate({"timing": {"delay": delay}})
    setting = Setting.of(policy, lab, 0.01, Wishes(errors=model), job="verify")
    told = {premise.name: premise for premise in setting.premises}
    assert told["delay"].source == "the error model"
    assert told["delay"].value == f"{delay[0]:g} to {delay[1]:g} s"


def test_a_bias_is_told_in_the_unit_of_its_channel(policy, lab):
    model = ErrorModel.model_validate({"sensor": {"lidar": {"absolute": 0.03, "bias": 0.01}}})
    setting = Setting.of(policy, lab, 0.01, Wishes(errors=model), job="verify")
    told = {premise.name: premise.value for premise in setting.premises}
    assert told["sensor.lidar.bias"] == "0.01 m"
    assert "sensor.lidar.absolute" not in told
    assert told["eps of lidar"] == "0.03 m"


def test_what_slips_is_not_said_to_be_without_slip(policy, lab):
    model = ErrorModel.model_validate({"actuation": {"slip": 0.02}})
    rules = Setting.of(policy, lab, 0.01, Wishes(errors=model), job="verify").rules
    assert "without slip" not in rules.moves_as
    assert "without slip" in Setting.of(policy, lab, 0.01, job="verify").rules.moves_as


@pytest.mark.parametrize("job", ["", *SUPPORTED])
def test_a_job_refuses_every_term_that_it_does_not_take_into_account(policy, lab, tmp_path, job):
    model = load_errors(written(tmp_path, EVERY_TERM))
    left = [place for place, term, _, _ in model.stated() if term not in SUPPORTED.get(job, frozenset())]
    if left:
        with pytest.raises(ConfigurationError) as caught:
            Setting.of(policy, lab, 0.01, Wishes(errors=model), job=job)
        assert all(place in str(caught.value) for place in left)


@pytest.mark.parametrize(
    "content",
    [
        {"sensor": {"lidar": {"absolute": -0.1}}},
        {"sensor": {"lidar": {"missing": 17}}},
        {"actuation": {"linear": {"relative": 1.0}}},
        {"actuation": {"linear": {"acceleration": 0.0}}},
        {"actuation": {"linear": {"acceleration": [0.0, 1.0]}}},
        {"timing": {"interval": [0.0, 0.1]}},
        {"pose": {"theta": 4.0}},
    ],
)
def test_the_published_schema_refuses_numbers_out_of_their_range(content):
    schema = json.loads(Path("docs/errors.schema.json").read_text())
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(content, schema)
