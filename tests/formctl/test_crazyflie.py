"""Set-points for Crazyflies: units, signs and limits, worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest

from formctl.deployment import crazyflie
from formctl.settings import compose


@pytest.fixture(scope="module")
def settings():
    return compose(["deploy=mocap"])


@pytest.fixture
def stream(settings):
    """Two drones: quarter roll, minus eighth pitch, twentieth yaw; thrust command 0.04 of full scale's half."""
    commands = np.tile([0.25, -0.125, 0.05, 0.04], (5, 2, 1))
    return crazyflie.setpoints(commands, settings.drone, 0.02)


def test_units(stream):
    assert stream.roll[0] == pytest.approx([45.0, 45.0])  # a quarter of 180 deg/s
    assert stream.pitch[0, 0] == pytest.approx(-22.5) and stream.yaw[0, 0] == pytest.approx(9.0)
    assert stream.thrust[0, 0] == round(65535 * (0.52 + 0.05))
    assert stream.time == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08])


def test_packets_carry_minus_pitch_and_come_back(stream):
    payload = crazyflie.packet(stream, 0, 1)
    assert len(payload) == 14 and payload[4:8] == np.float32(22.5).tobytes()
    assert crazyflie.unpack(payload) == pytest.approx((45.0, -22.5, 9.0, int(stream.thrust[0, 1])))


def test_a_good_stream_passes(stream, settings):
    assert all(check.ok for check in crazyflie.checks(stream, settings.deploy, settings.drone))


@pytest.mark.parametrize(
    ("what", "spoil"),
    [
        ("body rates", lambda s: s._replace(yaw=s.yaw + 60)),
        ("thrust", lambda s: s._replace(thrust=s.thrust - 20000)),
        ("thrust heard", lambda s: s._replace(thrust=s.thrust * 0 + 900)),
        ("thrust obeyed", lambda s: s._replace(thrust=s.thrust * 0 + 62000)),
        ("period", lambda s: s._replace(time=s.time * 1.1)),
        ("watchdog", lambda s: s._replace(time=s.time * 40)),
        ("numbers", lambda s: s._replace(roll=s.roll * np.nan)),
    ],
)
def test_each_fault_is_found(stream, settings, what, spoil):
    failed = [check.what for check in crazyflie.checks(spoil(stream), settings.deploy, settings.drone) if not check.ok]
    assert what in failed


def test_only_the_firmware_s_cut_is_not_hard(stream, settings):
    stream.thrust[:2, 0] = 62258, 61000
    assert crazyflie.cut(stream)[:2] == pytest.approx(np.array([[1 - 60000 / 62258, 0], [1 - 60000 / 61000, 0]]))
    found = crazyflie.checks(stream, settings.deploy, settings.drone)
    assert [(check.what, check.found, check.verdict) for check in found if not check.ok] == [
        ("thrust obeyed", "2 of 10 cut (20.0%), by up to 3.6%", "warning")
    ]
    assert [check.what for check in found if not check.hard] == ["thrust obeyed"]
    assert crazyflie.Check("period", "", "", ok=False).verdict == "NOT OK"


@pytest.mark.parametrize(("bias", "share"), [(0.05, 0.865), (0.0, 0.915), (0.1, 0.815)])
def test_the_largest_share_that_the_firmware_obeys(settings, bias, share):
    drone = replace(settings.drone, thrust_bias=bias)
    assert crazyflie.largest_share(drone) == share
    most = (
        crazyflie.setpoints(np.ones((1, 1, 4)), replace(drone, thrust_range=(0.4, top)), 0.02).thrust.max()
        for top in (share, share + 0.001)
    )
    assert next(most) <= 60000 < next(most)


def test_limits_of_the_craft_hold(settings):
    drone = replace(settings.drone, rate_clip=0.5, thrust_range=(0.4, 0.9))
    stream = crazyflie.setpoints(np.array([[[1.0, -1.0, 1.0, 1.0]], [[0.0, 0.0, 0.0, -1.0]]]), drone, 0.02)
    assert np.abs(stream.roll).max() == pytest.approx(np.degrees(0.5))
    assert list(stream.thrust[:, 0]) == [round(65535 * 0.95), round(65535 * 0.45)]


def test_the_file_begins_with_unlocking(stream):
    lines = crazyflie.lines(stream)
    assert lines[1].endswith(",0,0,0,0,0") and lines[2].endswith(",1,0,0,0,0")
    assert len(lines) == 1 + 2 + 10 and lines[3] == f"0.000,0,45.0000,-22.5000,9.0000,{stream.thrust[0, 0]}"
