"""An arm made of spheres, its SRDF, and another arm whose spheres touch always, sometimes and never."""

from robots import ball, filled, urdf

ARM = urdf(*[dict(kind="revolute", axis="0 1 0", xyz="0 0 0.3", limits=(-1.5, 1.5))] * 5, name="arm")
ARM = filled(ARM, {f"l{k}": ball(0.05) for k in range(6)})
SRDF = """<robot name="arm">
  <group name="upper"><chain base_link="l1" tip_link="l4"/></group>
  <group name="listed"><joint name="j0"/><joint name="j1"/><joint name="j2"/></group>
  <group name="all"><group name="listed"/><group name="upper"/></group>
  <end_effector name="hand" parent_link="l5" group="none" parent_group="listed"/>
  <group_state name="up" group="listed"><joint name="j0" value="0.1"/><joint name="j1" value=" 0.2 "/></group_state>
  <group_state name="up" group="upper"><joint name="j2" value="0.3"/><joint name="root_joint" value="0 0 0 0 0 0 1"/></group_state>
  <group_state name="far" group="x"><joint name="elsewhere" value="1"/></group_state>
  <passive_joint name="j4"/>
  <disable_collisions link1="l3" link2="l0" reason="Never"/>
  <disable_collisions link1="l0" link2="strange" reason="User"/>
  <virtual_joint name="fixed" type="fixed" parent_frame="world" child_link="l0"/><unknown><joint/></unknown>
</robot>"""

SAMPLED = urdf(
    *[dict(kind="revolute", axis="0 1 0", xyz="0 0 0.3", limits=(-2.5, 2.5))] * 4, name="balls &amp; &lt;sticks&gt;"
)
SAMPLED = filled(SAMPLED, {f"l{k}": ball(radius) for k, radius in enumerate((0.05, 0.05, 0.4, 0.05, 0.32))})
