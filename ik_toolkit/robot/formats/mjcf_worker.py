"""Subprocess that compiles MJCF for `mjcf.py`, so that a crash of MuJoCo ends this process only.

MuJoCo applies defaults, frames, replication and angles. Its job (JSON on stdin) has xml (without file references), memory
[bytes] and seconds. It prints one line of JSON: the parts of the model, or {"error": sentence}. Values are in metres and
radians, quaternions in the order w x y z.
"""

import importlib
import json
import os
import sys
import warnings
from pathlib import Path
from typing import Any

# This file runs as a script, so the package is importable only if its parent folder is on sys.path.
sys.path.append(str(Path(__file__).parents[3]))
from ik_toolkit.robot.formats.sandbox import limit

JOINTS = ("free", "ball", "slide", "hinge")
GEOMS = ("plane", "hfield", "sphere", "capsule", "ellipsoid", "cylinder", "box", "mesh")
EQUALITIES = ("connect", "weld", "joint", "tendon")
SITE = 6  # MuJoCo marks an equality as one between sites by this number.
MOST = 20_000  # A model with more than this many bodies, joints, geoms, sites, equalities or tendons is refused.


def pose_dict(pos: Any, quat: Any) -> dict:
    """Return a position (3,) [m] and a quaternion (4,) w, x, y, z as a dict of lists, ready for JSON."""
    return {"pos": pos.tolist(), "quat": quat.tolist()}


def equalities(m: Any) -> dict:
    """Return the equalities and tendons of a compiled MuJoCo model as a dict, ready for JSON."""
    return {
        "equalities": [
            {
                "name": m.eq(i).name,
                "type": EQUALITIES[m.eq_type[i]] if m.eq_type[i] < len(EQUALITIES) else "other",
                "sites": int(m.eq_objtype[i]) == SITE,
                "active": bool(m.eq_active0[i]),
                "first": int(m.eq_obj1id[i]),
                "second": int(m.eq_obj2id[i]),
                "data": m.eq_data[i][:11].tolist(),
            }
            for i in range(m.neq)
        ],
        "tendons": [
            {
                "name": m.tendon(i).name,
                "range": m.tendon_range[i].tolist() if m.tendon_limited[i] else None,
                "rest": float(m.tendon_length0[i]),
                "parts": [
                    [int(m.wrap_type[k]), int(m.wrap_objid[k]), float(m.wrap_prm[k])]
                    for k in range(m.tendon_adr[i], m.tendon_adr[i] + m.tendon_num[i])
                ],
            }
            for i in range(m.ntendon)
        ],
    }


def describe(m: Any) -> dict:
    """Return all that is read of a compiled MuJoCo model as a dict, ready for JSON; {"error": sentence} if it is too large."""
    if max(m.nbody, m.njnt, m.ngeom, m.nsite, m.neq, m.ntendon, m.nwrap) > MOST:
        return {"error": f"it has more than {MOST:,} bodies, joints, geoms, sites, equalities or tendons"}

    return {
        "name": m.names[: m.names.index(b"\0")].decode(errors="replace"),
        "bodies": [
            {
                "name": m.body(i).name,
                "parent": int(m.body_parentid[i]),
                **pose_dict(m.body_pos[i], m.body_quat[i]),
            }
            for i in range(m.nbody)
        ],
        "joints": [
            {
                "name": m.joint(i).name,
                "type": JOINTS[m.jnt_type[i]],
                "body": int(m.jnt_bodyid[i]),
                "pos": m.jnt_pos[i].tolist(),
                "axis": m.jnt_axis[i].tolist(),
                "range": m.jnt_range[i].tolist() if m.jnt_limited[i] else None,
                "given": m.jnt_range[i].tolist(),
                "ref": float(m.qpos0[m.jnt_qposadr[i]]),
                "place": int(m.jnt_qposadr[i]),
            }
            for i in range(m.njnt)
        ],
        "geoms": [
            {
                "type": GEOMS[m.geom_type[i]] if m.geom_type[i] < len(GEOMS) else "other",
                "body": int(m.geom_bodyid[i]),
                **pose_dict(m.geom_pos[i], m.geom_quat[i]),
                "size": m.geom_size[i].tolist(),
                "touches": bool(m.geom_contype[i] or m.geom_conaffinity[i]),
                "group": int(m.geom_group[i]),
                "rgba": (m.mat_rgba[m.geom_matid[i]] if m.geom_matid[i] >= 0 else m.geom_rgba[i]).tolist(),
                "mesh": int(m.geom_dataid[i]),
            }
            for i in range(m.ngeom)
        ],
        "meshes": [
            {
                "name": m.mesh(i).name,
                **pose_dict(m.mesh_pos[i], m.mesh_quat[i]),
                "scale": m.mesh_scale[i].tolist(),
            }
            for i in range(m.nmesh)
        ],
        "sites": [
            {
                "name": m.site(i).name,
                "body": int(m.site_bodyid[i]),
                **pose_dict(m.site_pos[i], m.site_quat[i]),
            }
            for i in range(m.nsite)
        ],
        **equalities(m),
        "excludes": [[int(pair) >> 16, int(pair) & 0xFFFF] for pair in m.exclude_signature],
        "keys": [{"name": m.key(i).name, "qpos": m.key_qpos[i].tolist()} for i in range(m.nkey)],
    }


def _main() -> None:
    """Read the job from stdin and write the answer to stdout."""
    job = json.load(sys.stdin)
    warnings.simplefilter("ignore")
    os.environ["MUJOCO_GL"] = "disable"  # The search for OpenGL, which is not needed, would take a quarter of the time.
    mujoco: Any = importlib.import_module("mujoco")
    limit("CORE", 0)
    limit("AS", job["memory"])
    limit("CPU", job["seconds"])
    try:
        answer = describe(mujoco.MjModel.from_xml_string(job["xml"]))
    except Exception as error:  # MuJoCo can raise an exception of any type.
        answer = {"error": " ".join(str(error).split())[:300] or type(error).__name__}
    print("\n" + json.dumps(answer))


if __name__ == "__main__":
    _main()
