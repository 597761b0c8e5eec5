"""Robot files: the joints of MJCF and URDF, as MuJoCo reads them.

MuJoCo gives the mass matrix M of a posture. One joint under kp and kd, the others without torque,
moves as an inertia 1/(M^-1)_ii; with the others held as M_ii, which is never less. Both are sampled
over postures; armature is in M, and adds to both (Sherman, Morrison). Joints that move only with
others are named with the reason.
"""

from copy import copy
from importlib import import_module
from math import inf, pi
from os import PathLike
from typing import Any
from xml.etree import ElementTree

import numpy as np

from jaxstab.loop.joint import PD, Joint
from jaxstab.shown import shortened
from jaxstab.tables import text_of

_SEED = 55  # of the postures
MOST_BYTES = 100_000_000
"""Of a file."""


def model_of(robot: Any) -> Any:
    """The model of a file, or a copy of one; of URDF neither shapes nor meshes are read."""
    mujoco = optional("mujoco")
    if isinstance(robot, mujoco.MjModel):
        return copy(robot)
    if not isinstance(robot, str | PathLike):
        raise TypeError(f"robot is {shortened(robot)}; give a file name or a mujoco.MjModel.")
    try:
        root = ElementTree.fromstring(text_of(robot, MOST_BYTES))
        if root.tag != "robot":
            return mujoco.MjModel.from_xml_path(str(robot))
        for link in root.iter("link"):
            for shape in [*link.findall("visual"), *link.findall("collision")]:
                link.remove(shape)
        return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
    except (ElementTree.ParseError, ValueError) as error:
        words = " ".join(str(error).split()).rstrip(".")
        raise ValueError(f"MuJoCo reads no robot from {robot}: {words}.") from error


def optional(name: str) -> Any:
    """A package of the extra ``robots``; RuntimeError without it."""
    try:
        return import_module(name)
    except ImportError as error:
        raise RuntimeError(
            f"robot files need the package {name}: python -m pip install 'jaxstab[robots]'."
        ) from error


def joints_of(model: Any, postures: int) -> dict[str, Joint]:
    """The joints by their names, with their inertias over postures."""
    import mujoco

    least, greatest = _inertias(model, postures)
    reasons, servos, joints = _reasons(model), _other_servos(model), {}
    no_springs, no_dampers = (_is_off(model, name) for name in ("SPRING", "DAMPER"))
    for index, (name, kind) in enumerate(zip(_names(model), model.jnt_type.tolist(), strict=True)):
        place = model.jnt_dofadr[index]
        (kp, kd), damping = _actuators(model, index)
        negative = f"its actuators have kp = {kp:g} and kd = {kd:g}; give gains of 0 or more"
        joints[name] = Joint(
            kind != mujoco.mjtJoint.mjJNT_SLIDE,
            float(least[place]),
            float(greatest[place]),
            0.0 if no_dampers else float(model.dof_damping[place]) + damping,
            0.0 if no_springs else float(model.jnt_stiffness[index]),
            float(model.dof_frictionloss[place]),
            (kp, kd),
            reasons.get(index),
            servos.get(index) or (negative if min(kp, kd) < 0.0 else None),
        )
    return joints


def _names(model: Any) -> list[str]:
    """The names of the joints; the number of one without, in a name that no other one has."""
    given = [model.joint(index).name for index in range(model.njnt)]
    names = []
    for index, own in enumerate(given):
        name = own or f"joint {index}"
        while not own and name in given:
            name += " (no name)"
        names.append(name)
    return names


def _is_off(model: Any, part: str) -> bool:
    """True if the file disables a part of the simulation; old versions know PASSIVE alone."""
    import mujoco

    bits = mujoco.mjtDisableBit
    part = "PASSIVE" if hasattr(bits, "mjDSBL_PASSIVE") and part in ("SPRING", "DAMPER") else part
    return bool(model.opt.disableflags & int(getattr(bits, f"mjDSBL_{part}")))


def _acting(model: Any) -> np.ndarray:
    """True for actuators that the file does not disable, all of them or by their group."""
    off, groups = model.opt.disableactuator, model.actuator_group
    in_group = (groups >= 0) & (groups < 31) & (off >> np.clip(groups, 0, 30) & 1 > 0)
    return ~in_group & (not _is_off(model, "ACTUATION"))


def _actuators(model: Any, joint: int) -> tuple[PD, float]:
    """The gains of the position and velocity actuators of a joint, and the damping they add."""
    import mujoco

    own = _at_joints(model) & (model.actuator_trnid[:, 0] == joint) & _acting(model)
    has_bias = np.equal(model.actuator_biastype, int(mujoco.mjtBias.mjBIAS_AFFINE))
    gear = model.actuator_gear[own, 0] ** 2  # of the angle, and of the torque
    damping = getattr(model, "actuator_damping", np.zeros(len(own)))[own]  # new versions have it
    kp, kd = -(gear * has_bias[own]) @ model.actuator_biasprm[own, 1:3]
    return (float(kp) + 0.0, float(kd) + 0.0), float(gear @ damping)


def _at_joints(model: Any) -> np.ndarray:
    import mujoco

    places = mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT
    return np.isin(model.actuator_trntype, [*map(int, places)])


def _other_servos(model: Any) -> dict[int, str]:
    """Joints that an actuator moves by another law than kp and kd of their own angle, and which."""
    import mujoco

    ways, at_joint, found = mujoco.mjtTrn, _at_joints(model), dict[int, str]()
    for index in np.flatnonzero(_acting(model)).tolist():
        way, ends = ways(model.actuator_trntype[index]), model.actuator_trnid[index].tolist()
        is_pd, moved = _is_pd(model, index), set[int]()
        if at_joint[index] and not is_pd:
            moved = {ends[0]}
        elif way in (ways.mjTRN_SITE, ways.mjTRN_SLIDERCRANK):
            is_motor = is_pd and not np.any(model.actuator_biasprm[index, 1:3])
            for body in model.site_bodyid[[end for end in ends if end >= 0 and not is_motor]]:
                moved ^= _above(model, int(body))
        name = model.actuator(index).name or index
        words = f"actuator {name} has another law than kp and kd of this joint; give its gains"
        found |= dict.fromkeys(moved, words)
    return found


def _is_pd(model: Any, actuator: int) -> bool:
    """True if its force is kp and kd times its own length and speed, and what it is commanded."""
    import mujoco

    bias = mujoco.mjtBias(model.actuator_biastype[actuator]).name
    kind = mujoco.mjtGain(model.actuator_gaintype[actuator]).name
    gain, *slopes = model.actuator_gainprm[actuator, :3]
    has_gain = {
        "mjGAIN_FIXED": True,
        "mjGAIN_AFFINE": not any(slopes),  # else commands change the stiffness
        "mjGAIN_PID": gain == 0.0,  # of the integral
    }
    is_linear = bias in ("mjBIAS_NONE", "mjBIAS_AFFINE") and has_gain.get(kind, False)
    own = model.actuator_plugin[actuator] < 0 and not _curve(model, "actuator_damping", actuator)
    return bool(is_linear and own)


def _curve(model: Any, name: str, index: int) -> bool:
    """True if a spring or damper has coefficients beyond the linear one, as in new versions."""
    return bool(np.any(getattr(model, f"{name}poly", np.zeros((index + 1, 1)))[index]))


def _reasons(model: Any) -> dict[int, str]:
    """Why joints are not answered for: several of them, or several axes, move together."""
    import mujoco

    kinds, ways, along = mujoco.mjtJoint, mujoco.mjtEq, _along_tendons(model)
    reasons = dict[int, str]()
    for index, place in enumerate(model.jnt_dofadr.tolist()):
        if _curve(model, "jnt_stiffness", index) or _curve(model, "dof_damping", place):
            reasons[index] = "its spring or damper is not linear"
    at_tendon = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_TENDON)
    driven = model.actuator_trnid[at_tendon & _acting(model), 0]
    for index in range(model.ntendon):
        held = model.tendon_stiffness[index] or model.tendon_damping[index]
        curves = (_curve(model, f"tendon_{part}", index) for part in ("stiffness", "damping"))
        if index in driven or held or any(curves):
            words = f"tendon {model.tendon(index).name or index} moves it with other joints"
            reasons |= dict.fromkeys(along[index], words)
    for index in np.flatnonzero(model.eq_active0 * (not _is_off(model, "EQUALITY"))).tolist():
        kind, pair = int(model.eq_type[index]), (model.eq_obj1id[index], model.eq_obj2id[index])
        ends, words = [end for end in map(int, pair) if end >= 0], "ties it to another joint"
        tied = {*ends} if kind == ways.mjEQ_JOINT else set[int]()
        words = "holds it at a place" if len(tied) == 1 else words
        if kind == ways.mjEQ_TENDON:
            tied = tied.union(*(along[end] for end in ends))
        elif kind in (ways.mjEQ_CONNECT, ways.mjEQ_WELD):
            if int(model.eq_objtype[index]) == mujoco.mjtObj.mjOBJ_SITE:
                ends = model.site_bodyid[ends].tolist()
            first, second = (_above(model, body) for body in ends)
            tied, words = first ^ second, "closes a chain that it is in"
        words = f"equality {model.equality(index).name or index} {words}"
        reasons |= dict.fromkeys(tied, words)
    several = {kinds.mjJNT_FREE: "it moves freely", kinds.mjJNT_BALL: "a ball, of three axes"}
    types = enumerate(map(kinds, model.jnt_type.tolist()))
    return reasons | {index: several[kind] for index, kind in types if kind in several}


def _above(model: Any, body: int) -> set[int]:
    """The joints between the world and a body."""
    joints = set[int]()
    while body:
        start = int(model.body_jntadr[body])
        joints |= {*range(start, start + int(model.body_jntnum[body]))}
        body = int(model.body_parentid[body])
    return joints


def _along_tendons(model: Any) -> list[set[int]]:
    """The joints that change the length of each tendon, next to some posture."""
    import mujoco

    data, near = mujoco.MjData(model), 1e-4
    here, lengths = _posture(model, np.random.default_rng(_SEED)), list[np.ndarray]()
    for place in (0, *model.jnt_qposadr.tolist()):
        data.qpos[:] = here
        data.qpos[place] += near if lengths else 0.0
        mujoco.mj_fwdPosition(model, data)
        lengths.append(data.ten_length.copy())
    changes = np.abs(np.array(lengths[1:]) - lengths[0]) > 1e-6 * near
    return [{*np.flatnonzero(changed).tolist()} for changed in changes.T]


def _inertias(model: Any, postures: int) -> tuple[np.ndarray, np.ndarray]:
    """The least 1/(M^-1)_ii and the greatest M_ii over postures, the file's own among them."""
    import mujoco

    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data, rng, units = mujoco.MjData(model), np.random.default_rng(_SEED), np.eye(model.nv)
    mass, (least, greatest) = np.zeros_like(units), (np.full(model.nv, inf), np.zeros(model.nv))
    for number in range(postures):
        data.qpos[:] = _posture(model, rng) if number else model.qpos0
        mujoco.mj_fwdPosition(model, data)
        for row, unit in zip(mass, units, strict=True):
            mujoco.mj_mulM(model, data, row, unit)
        least = np.minimum(least, 1.0 / np.diag(np.linalg.inv(mass)))
        greatest = np.maximum(greatest, np.diag(mass))
    if not (model.nv and np.all((least > 0.0) & np.isfinite(greatest))):
        raise ValueError(
            "the robot has no joint, or its mass matrix is not positive; give one that moves, with "
            "masses and inertias of all bodies."
        )
    return np.minimum(least, greatest), greatest


def _posture(model: Any, rng: np.random.Generator) -> np.ndarray:
    """Joints anywhere in their ranges, hinges without one anywhere in a turn."""
    import mujoco

    place, kinds = model.qpos0.copy(), mujoco.mjtJoint
    for index, kind in enumerate(model.jnt_type.tolist()):
        at = model.jnt_qposadr[index]
        if kind == kinds.mjJNT_BALL:
            turn = rng.standard_normal(4)
            place[at : at + 4] = turn / np.linalg.norm(turn)
        elif model.jnt_limited[index] and kind != kinds.mjJNT_FREE:
            place[at] = rng.uniform(*model.jnt_range[index])
        elif kind == kinds.mjJNT_HINGE:
            place[at] = rng.uniform(-pi, pi)
    return place
