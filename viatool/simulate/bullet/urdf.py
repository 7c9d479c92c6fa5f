"""Robot descriptions (URDF) from the figures of `RobotModel`."""

from __future__ import annotations

from viatool.simulate.models import RobotModel

LEFT, RIGHT = "left_wheel_joint", "right_wheel_joint"
"""The two driven joints."""

_BODY, _DECK, _TYRE, _SENSOR = "0.22 0.25 0.30 1", "0.95 0.62 0.07 1", "0.06 0.06 0.07 1", "0.10 0.35 0.65 1"
_GRIP = "lateral_friction"


def write_urdf(model: RobotModel) -> str:
    """Return the description of a robot, with the origin on the floor between the driven wheels.

    Parameters
    ----------
    model : RobotModel
        Its figures.

    Returns
    -------
    str
        URDF. The driven wheels touch the floor as spheres, so that the point of contact, and with it the track, does
        not wander; they are drawn as cylinders. Casters are spheres without friction; a base that is pushed has four of
        them and no wheels.
    """
    parts = [_chassis(model), _sensor(model)]
    sides = (0.0,) if not model.pushed else (0.4 * model.width, -0.4 * model.width)
    if not model.pushed:
        parts += [_driven_wheel(model, joint, side) for joint, side in ((LEFT, 1.0), (RIGHT, -1.0))]
    for end, direction in (("front", 1.0), ("rear", -1.0)):
        for number, side in enumerate(sides):
            parts.append(_caster(model, f"{end}_caster_{number}", direction, side))
    for index, (ahead, side) in enumerate(_idle_wheels(model)):
        parts.append(_idle_wheel(model, f"idle_wheel_{index}", ahead, side))
    return f'<?xml version="1.0"?>\n<robot name="{model.name}">\n{"".join(parts)}</robot>\n'


def _chassis(model: RobotModel) -> str:
    """Return the base link; two small casters count with it."""
    mass = model.mass - 2.0 * model.wheel_mass
    x, y, z = model.length, model.width, model.height
    middle = model.ground_clearance + 0.5 * z
    inertia = tuple(mass / 12.0 * (a * a + b * b) for a, b in ((y, z), (x, z), (x, y)))
    low = model.ground_clearance + 0.3 * z  # batteries and motors stand at the bottom
    box = f'<box size="{x} {y} {z}"/>'
    deck = f'<box size="{0.8 * x} {0.8 * y} 0.01"/>'
    top = model.ground_clearance + z + 0.005
    return (
        f'<link name="base">{_inertial(mass, inertia, low, model.ahead)}'
        f"{_visual(box, _BODY, x=model.ahead, z=middle)}{_visual(deck, _DECK, x=model.ahead, z=top)}"
        f'<collision><origin xyz="{model.ahead} 0 {middle}"/><geometry>{box}</geometry></collision></link>\n'
    )


def _sensor(model: RobotModel) -> str:
    """Return the LiDAR: seen, but neither hit nor heavy."""
    radius = min(0.035, 0.2 * model.width)
    top = model.ground_clearance + model.height
    height = max(0.04, model.lidar_height - top + 0.02)
    can = _visual(f'<cylinder radius="{radius}" length="{height}"/>', _SENSOR, z=top + 0.5 * height)
    return f'<link name="lidar">{_inertial(0.001, (1e-6,) * 3, top)}{can}</link>\n' + _fixed("lidar")


def _driven_wheel(model: RobotModel, joint: str, side: float) -> str:
    radius, mass = model.wheel_radius, model.wheel_mass
    name = joint.removesuffix("_joint")
    inertia = 0.5 * mass * radius * radius
    drawn = _visual(_tyre(model), _TYRE, turn="1.5707963 0 0") if not model.wheelbase else ""
    ball = f'<geometry><sphere radius="{radius}"/></geometry>'
    grip = f'<contact><{_GRIP} value="{model.friction}"/></contact>'
    at = f'<origin xyz="0 {side * 0.5 * model.track} {radius}"/>'
    return (
        f'<link name="{name}">{grip}{_inertial(mass, (inertia,) * 3, 0.0)}{drawn}<collision>{ball}</collision></link>\n'
        f'<joint name="{joint}" type="continuous"><parent link="base"/><child link="{name}"/>{at}'
        f'<axis xyz="0 1 0"/><limit effort="{model.wheel_torque}" velocity="1000"/></joint>\n'
    )


def _caster(model: RobotModel, name: str, direction: float, side: float) -> str:
    radius = model.caster_radius
    ball = f'<geometry><sphere radius="{radius}"/></geometry>'
    at = f"{model.ahead + direction * 0.4 * model.length} {side} {radius}"
    return (
        f'<link name="{name}"><contact><{_GRIP} value="0"/></contact>{_inertial(0.001, (1e-6,) * 3, 0.0)}'
        f"<collision>{ball}</collision></link>\n{_fixed(name, at)}"
    )


def _idle_wheels(model: RobotModel) -> list[tuple[float, float]]:
    """Return where the four wheels of a skid-steered robot are drawn."""
    if not model.wheelbase:
        return []
    return [(a * 0.5 * model.wheelbase, s * 0.5 * model.track) for a in (1.0, -1.0) for s in (1.0, -1.0)]


def _idle_wheel(model: RobotModel, name: str, ahead: float, side: float) -> str:
    drawn = _visual(_tyre(model), _TYRE, turn="1.5707963 0 0")
    return (
        f'<link name="{name}">{_inertial(0.001, (1e-6,) * 3, 0.0)}{drawn}</link>\n'
        f"{_fixed(name, f'{ahead} {side} {model.wheel_radius}')}"
    )


def _tyre(model: RobotModel) -> str:
    return f'<cylinder radius="{model.wheel_radius}" length="{model.wheel_width}"/>'


def _fixed(name: str, at: str = "0 0 0") -> str:
    return (
        f'<joint name="{name}_joint" type="fixed"><parent link="base"/><child link="{name}"/>'
        f'<origin xyz="{at}"/></joint>\n'
    )


def _inertial(mass: float, inertia: tuple[float, ...], height: float, ahead: float = 0.0) -> str:
    xx, yy, zz = inertia
    return (
        f'<inertial><origin xyz="{ahead} 0 {height}"/><mass value="{mass}"/>'
        f'<inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/></inertial>'
    )


def _visual(geometry: str, colour: str, *, x: float = 0.0, z: float = 0.0, turn: str = "0 0 0") -> str:
    return (
        f'<visual><origin xyz="{x} 0 {z}" rpy="{turn}"/><geometry>{geometry}</geometry>'
        f'<material name="m_{colour.replace(" ", "_").replace(".", "")}"><color rgba="{colour}"/></material></visual>'
    )
