"""What a certificate says it assumes: ideal in what the error model leaves out, and not in what it states."""

from __future__ import annotations

from collections.abc import Mapping

from viatool.places import Certificate
from viatool.report.places.document import PlacesDocument


def assumed(certificate: Certificate, terms: Mapping[str, str]) -> Mapping[str, str]:
    told = certificate.to_json()
    told["premises"] += [{"name": name, "value": value, "source": "file"} for name, value in terms.items()]
    return PlacesDocument(told).assumptions


def test_a_robot_without_an_error_model_is_ideal(certificate: Certificate) -> None:
    told = assumed(certificate, {})
    assert told["motion"] == "exact arcs without slip"
    assert told["timing"] == "commands act after 0 s, until then the one before goes on"
    assert told["map"] == "correct, and nothing on it moves"
    assert "pose" not in told


def test_what_motors_do_is_no_exact_arc(certificate: Certificate) -> None:
    told = assumed(certificate, {"actuation.linear.lag": "0.05 to 0.1 s"})
    assert (
        told["motion"]
        == "arcs without slip, followed within actuation.linear.lag 0.05 to 0.1 s, anew at every instant"
    )
    told = assumed(certificate, {"actuation.linear.relative": "0.02 share", "actuation.slip": "0.05 share"})
    assert "without slip" not in told["motion"]
    assert "exact" not in told["motion"]
    assert "actuation.linear.relative 0.02 share, actuation.slip 0.05 share" in told["motion"]


def test_stated_times_take_the_place_of_the_delay(certificate: Certificate) -> None:
    told = assumed(certificate, {"timing.interval": "0.09 to 0.12 s"})
    assert told["timing"].startswith("commands act after 0 s")
    assert "timing.interval 0.09 to 0.12 s" in told["timing"]
    told = assumed(certificate, {"timing.delay": "0 to 0.1 s"})
    assert told["timing"] == "within timing.delay 0 to 0.1 s, anew for every command"


def test_readings_pose_and_obstacles_are_as_stated(certificate: Certificate) -> None:
    terms = {"sensor.lidar.missing": "2 rays", "pose.x": "0.05 m", "obstacles.speed": "1.2 m/s"}
    told = assumed(certificate, terms)
    assert told["sensors"].endswith(", but for sensor.lidar.missing 2 rays")
    assert told["pose"] == "as localised, but for pose.x 0.05 m"
    assert told["map"].startswith("correct; obstacles.speed 1.2 m/s may move")
    assert told["motion"] == "exact arcs without slip"
