"""ROS 2 bags as drivers write them: joints in an order of their own, a gripper on the same topic, and a topic of another kind."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from didim.log.ros_bag import CONTROLLER_STATE, JOINT_STATE

Array = NDArray[np.float64]

CONTROLLER = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
trajectory_msgs/JointTrajectoryPoint error
trajectory_msgs/JointTrajectoryPoint output
"""


def header(store: Any, nanoseconds: int) -> Any:
    time = store.types["builtin_interfaces/msg/Time"]
    stamp = time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id="")


def write_bag(
    path: Path,
    joints: Sequence[str],
    t: Array,
    q: Array,
    effort: Array,
    *,
    reference: Array | None = None,
    mcap: bool = False,
    version: int = 9,
    shuffled: bool = True,
    start_s: int = 0,
) -> None:
    """Write joint states, and with a reference states of a trajectory controller; received in another order than stamped."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(CONTROLLER, CONTROLLER_STATE))
    state = store.types[JOINT_STATE]
    rng = np.random.default_rng(0)
    order = rng.permutation(len(joints)) if shuffled else np.arange(len(joints))
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    empty = np.zeros(0)
    with Writer(path, version=version, storage_plugin=plugin) as writer:  # type: ignore[arg-type]
        states = writer.add_connection("/joint_states", JOINT_STATE, typestore=store)
        text = writer.add_connection("/rosout", "std_msgs/msg/String", typestore=store)
        writer.write(
            text, 1, store.serialize_cdr(store.types["std_msgs/msg/String"](data="hello"), text.msgtype)
        )
        if reference is not None:
            controlled = writer.add_connection("/arm_controller/state", CONTROLLER_STATE, typestore=store)
        point = store.types["trajectory_msgs/msg/JointTrajectoryPoint"]
        duration = store.types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)

        def values(positions: Array, effort: Array) -> Any:
            return point(
                positions=positions,
                velocities=empty,
                accelerations=empty,
                effort=effort,
                time_from_start=duration,
            )

        for k, seconds in enumerate(t.tolist()):
            stamp = start_s * 1_000_000_000 + round(seconds * 1e9)
            # Neighbours arrive in the wrong order now and then.
            received = 1_000 * (k + (1.5 if k % 50 == 0 else 0.0))
            arm = state(
                header=header(store, stamp),
                name=[joints[j] for j in order],
                position=q[k, order],
                velocity=np.zeros(len(joints)),
                effort=effort[k, order],
            )
            writer.write(states, int(received), store.serialize_cdr(arm, JOINT_STATE))
            if k % 10 == 0:
                gripper = state(
                    header=header(store, stamp + 1),
                    name=["finger"],
                    position=np.zeros(1),
                    velocity=empty,
                    effort=empty,
                )
                writer.write(states, int(received), store.serialize_cdr(gripper, JOINT_STATE))
            if reference is not None:
                message = store.types[CONTROLLER_STATE](
                    header=header(store, stamp),
                    joint_names=list(joints),
                    reference=values(reference[k], empty),
                    feedback=values(q[k], empty),
                    error=values(reference[k] - q[k], empty),
                    output=values(empty, effort[k]),
                )
                writer.write(controlled, int(received), store.serialize_cdr(message, CONTROLLER_STATE))


def write_trajectory(path: Path, joints: Sequence[str], t: Array, q: Array, effort: Array) -> None:
    """Write one message of a joint trajectory, whose points have times from its start."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "trajectory_msgs/msg/JointTrajectory"
    duration = store.types["builtin_interfaces/msg/Duration"]
    point = store.types["trajectory_msgs/msg/JointTrajectoryPoint"]
    empty = np.zeros(0)
    points = []
    for seconds, positions, torques in zip(t.tolist(), q, effort, strict=True):
        whole, rest = divmod(round(seconds * 1e9), 1_000_000_000)
        points.append(
            point(
                positions=positions,
                velocities=empty,
                accelerations=empty,
                effort=torques,
                time_from_start=duration(sec=whole, nanosec=rest),
            )
        )
    message = store.types[kind](header=header(store, 0), joint_names=list(joints), points=points)
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/trajectory", kind, typestore=store)
        writer.write(connection, 0, store.serialize_cdr(message, kind))
