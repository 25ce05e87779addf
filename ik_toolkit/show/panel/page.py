"""The page of one panel visitor: controls and 3-D view (viser) for a Session."""

import functools
import html
from collections.abc import Sequence
from contextlib import nullcontext
from typing import Any

import numpy as np

from ...robot.library import list_robots
from ...style import BAD, GOOD
from ...text import how_many, parameter
from ...validate import positive
from ..body import Body
from .connection import PLAIN, Past, Visit, empty
from .learn_tab import Learn
from .scene_tab import Around, null_directions, slide
from .session import PATIENCE
from .solve_tab import Chart, Goal, SolutionsTab
from .tables import Recorder, as_sentence, note_html, pose_html, table_html
from .viser_scene import Stage

STEPS = 500  # smallest number of steps that a slider for a joint has
# [rad or arm reaches] how far the slider for the self-motion (joints move, tip stays) moves the joints to either side
PUSH = 3.0
MOST_TIPS = 4  # largest number of tips that can be chosen on the page


class PanelPage(Visit):
    """The panel's page for one visitor: controls and 3-D view. files: whether robots may be loaded by path, not only by name."""

    # -------------------------------------------------------------------------------------------------------- build
    def build(self) -> None:
        """Build the robot and its controls anew, after a change of robot, tip or units."""
        s = self.session
        body = Body(s.robot)
        with self.client.atomic():
            self.scene.reset()
            dragged = functools.partial(self._post, "drag", self._dragged)
            self.stage = Stage(self.client, body, s.q, s.goals(), self.frames, dragged, self.stage)
            self.gui.reset()
            self.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
            self.gui.main_panel.dock_right()
            self._build_controls()
        self.show()
        route = f"{s.robot.base} to {' and '.join(s.robot.tips)}"
        words = body.notice or f"{s.robot.name}: {route}, {how_many(s.robot.n, 'joint')}"
        self.say(f"{words}. Loading the tracker; the first time it compiles for about half a minute.")
        waiting = self.status.content
        self.worker.post("prepare", self._guard(self.session.prepare))
        self.worker.post("ready", self._guard(lambda: self.say(words, instead_of=waiting)))

    def _build_controls(self) -> None:
        s, gui = self.session, self.gui
        names = [entry.name for entry in list_robots()]
        names = names if s.source in names else [s.source, *names]
        self._ask(gui.add_dropdown("Robot", names, initial_value=s.source), "build", self._switch)
        self._build_tips()
        hint = "Angles in degrees; otherwise radians. Lengths in metres."
        self._ask(gui.add_checkbox("Degrees", s.degrees, hint=hint), "build", self._units)
        self.status = gui.add_html("")
        self.facts = gui.add_html("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Joints"):
            self._build_joints()
        with tabs.add_tab("Solve"):
            self._build_solve()
        with tabs.add_tab("Scene"):
            self.around = Around(self)
        with tabs.add_tab("Learn"):
            self.learn = Learn(self)
        with tabs.add_tab("Robot"):
            self._build_robot()

    def _build_tips(self) -> None:
        """Add a drop-down list for each tip solved for, and one more to add another."""
        s = self.session
        chosen, every = s.robot.tips, list(dict.fromkeys([*s.robot.tips, *s.tips]))
        if len(every) < 2:
            return
        none, lists = "none", []
        for k in range(min(len(chosen) + 1, len(every), MOST_TIPS)):
            now = chosen[k] if k < len(chosen) else none
            offered = [tip for tip in every if tip == now or tip not in chosen]
            label = f"Tip {k + 1}" if k else "Tip"
            offered = [none, *offered] if k else offered
            lists.append(self.gui.add_dropdown(label, offered, initial_value=now))
        for one in lists:
            self._on(one, "build", lambda: self._switch(s.source, [x.value for x in lists if x.value != none]))

    def _build_joints(self) -> None:
        s, gui = self.session, self.gui
        self.sliders, self.shown = [], [0.0] * s.robot.n
        for i, name in enumerate(s.robot.joint_names):
            low, high = s.range(i)
            step = 10.0 ** np.floor(np.log10(max(high - low, 1e-6) / STEPS))
            slider = gui.add_slider(f"{name} [{s.unit(i)}]", low, high, float(step), low)
            self.sliders.append(self._on(slider, "joints", self._moved))
        hint = "Moves the joints of a redundant arm while its tip stays where it is."
        self.push = self._on(gui.add_slider("Self-motion", -1.0, 1.0, 0.01, 0.0, hint=hint), "push", self._push)
        self.pushed = 0.0
        self._button("Undo", "undo", self._undo)
        self._button("Random pose", "anywhere", self._anywhere)
        self._button("Reset to home", "home", self._home)
        self._button("Copy as JSON", "json", self._json)
        self.recorder = Recorder(self)
        self.pose = gui.add_html("")

    def _build_goals(self) -> None:
        """Build the controls of each tip's target."""
        s, self.goals = self.session, []
        for tip, handle in zip(s.robot.tips, self.stage.handles, strict=True):
            with self.gui.add_folder(tip) if len(s.robot.tips) > 1 else nullcontext():
                self.goals.append(Goal(self, tip, self.kinds.get(tip, s.kind), handle))

    def _build_solve(self) -> None:
        s, gui = self.session, self.gui
        self._build_goals()
        self._button("Solve", "solve", self._solve, "blue")
        follow = gui.add_checkbox("Follow while dragging", self.live, hint="Drag the arrows and rings in the view.")
        self._ask(follow, "live", lambda live: setattr(self, "live", live))
        several = len(s.robot.tips) > 1
        self._button("Targets to tips" if several else "Target to tip", "solve", self._target_to_tip)
        self._button("Random targets" if several else "Random target", "solve", self._random)
        self._button("All solutions", "solve", self._solve_all)
        self.outcome = gui.add_html("", visible=False)
        self.found = SolutionsTab(self)
        with gui.add_folder("Solver"):
            self._ask(gui.add_dropdown("Method", s.choices(), initial_value=s.solver), "choice", self._choose)
            self.tolerance = gui.add_text("Tolerance [m, rad]", f"{s.tolerance:g}")
            hint = "Off: joints may go anywhere, as if they had no limits."
            self._ask(gui.add_checkbox("Joint limits", s.limits, hint=hint), "build", self._limits)
            self.parameters = gui.add_folder("Parameters", visible=False)
        self._fill_parameters()
        with gui.add_folder("Convergence"):
            self.chart = Chart(self.client)

    def _build_robot(self) -> None:
        s, gui = self.session, self.gui
        self._ask(gui.add_checkbox("Show joint frames", self.frames), "frames", self._show_frames)
        axes = table_html(s.axes(), ("joint", "kind", "axis", "through [m]"))
        gui.add_html(note_html(s.entry.description) + note_html("joint axes at home, in base axes") + axes)
        if self.files:
            hint = "A name (panda, ur5, ...) or the path of a .urdf on the machine the panel runs on."
            path = gui.add_text("Other robot", "", hint=hint)
            self._button("Load", "build", lambda: self._switch(path.value))

    def show(self) -> None:
        """Show the session's joint values in the view, the sliders and the numbers."""
        s = self.session
        with self.client.atomic():
            self.stage.show(s.q)
            self.stage.gaps(False)
            for i, slider in enumerate(self.sliders):
                rounded = round(s.scale(i) * float(s.q[i]), s.digits(i)) + 0.0
                slider.value = self.shown[i] = float(np.clip(rounded, slider.min, slider.max))
        if self.around is not None:
            self.facts.content = self.around.show()
        if self.learn is not None:
            self.learn.show(s.q)
        self.pose.content = "".join(pose_html(T, s, tip) for tip, T in s.poses().items())
        self.client.flush()  # send the changes now, not at the end of viser's interval

    # ------------------------------------------------------------------------------------------------------ actions
    def _switch(self, source: str, tips: str | Sequence[str] | None = None) -> None:
        if not self.files and source not in {entry.name for entry in list_robots()}:
            self.say("robots can be chosen by name only: this panel is open to other machines", BAD)
            return
        self.session.load(source, tips)
        self.session.solver, self.session.parameters, self.kinds = "auto", {}, {}
        self.past = Past()
        self.build()

    def _units(self, degrees: bool) -> None:
        self.session.degrees = degrees
        self._again()

    def _again(self) -> None:
        """Build the controls anew, but keep for each tip how its orientation is given."""
        self.kinds = {goal.tip: goal.kind for goal in self.goals}
        self.build()

    def _moved(self) -> None:
        s = self.session
        s.q = s.read_joints([slider.value for slider in self.sliders], self.shown, s.scale, s.limits)
        self.show()

    def _push(self) -> None:
        """Move through the self-motion as far as the slider says; the tips' orientations are held only where they are targeted."""
        s, value = self.session, float(np.clip(self.push.value, -1.0, 1.0))
        turns = any(goal.posed for goal in self.goals)
        if not np.isfinite(value) or not len(null_directions(s.robot, s.q, turns)):
            self.say("no self-motion: the tip's pose fixes every joint" + ("; try the orientation 'free'" * turns))
            return
        # arbitrary direction of joint motion: the one self-motion nearest to it is followed
        along = np.cos(np.arange(s.robot.n))
        s.q = slide(s.robot, s.q, along, PUSH * (value - self.pushed), turns, s.limits)
        self.pushed = value
        self.show()

    def _anywhere(self) -> None:
        """Move the robot to random joint values, and its targets to its tips."""
        s = self.session
        s.q = s.robot.random_q(s.random)
        self.show()
        self._target_to_tip()
        self.say("random joint values")

    def _undo(self) -> None:
        """Undo the last change of the robot's configuration."""
        before = self.past.back()
        if before is None:
            self.say("nothing to undo")
            return
        self.session.q, targets = before
        self._put(targets)
        self.show()
        self.say("undone")

    def _limits(self, limits: bool) -> None:
        """Switch joint limits on or off; when they are switched on, move back inside them."""
        s = self.session
        s.limits = limits
        s.q = np.clip(s.q, s.robot.lower, s.robot.upper) if limits else s.q
        self._again()

    def _home(self) -> None:
        s = self.session
        s.q, s.result, s.followed, s.solutions = s.robot.home.copy(), None, None, []
        self._hide_answer()
        self.outcome.visible = False
        self.show()
        self._target_to_tip()
        self.say("at home")

    def _json(self) -> None:
        self._dialog(
            "JSON (metres and radians)",
            '<textarea id="ik-json" readonly rows="14" style="width:100%;box-sizing:border-box;font:11px monospace">'
            f'{html.escape(self.session.to_json())}</textarea><button style="margin:6px 0;padding:6px 14px" '
            "onclick=\"const t=document.getElementById('ik-json');t.select();"
            "(navigator.clipboard?navigator.clipboard.writeText(t.value):Promise.reject())"
            ".catch(()=>document.execCommand('copy')).then(()=>this.textContent='Copied')\">Copy</button>",
        )

    def _choose(self, name: str) -> None:
        self.session.solver, self.session.parameters = name, {}
        self._fill_parameters()

    def _fill_parameters(self) -> None:
        empty(self.parameters)
        fields = self.session.fields()
        self.typed_parameters = {}
        self.parameters.visible = bool(fields)
        with self.parameters:
            for name, default in fields.items():
                text = "" if default is None else str(default)
                hint = f"default {default}" if text else "the method's own default"
                self.typed_parameters[name] = self.gui.add_text(name, text, hint=hint)

    def _typed(self) -> Any:
        """Read the target from the fields, and the solver's settings from theirs."""
        s = self.session
        fields = s.fields()
        typed = {name: handle.value for name, handle in self.typed_parameters.items()}
        s.parameters = {name: text for name, text in typed.items() if text.strip() != str(fields[name])}
        s.tolerance = positive(parameter("tolerance", self.tolerance.value), "the tolerance")
        return self._joined({goal.tip: goal.typed() for goal in self.goals})

    def _joined(self, targets: dict[str, np.ndarray | None]) -> Any:
        """Return targets in the form the robot expects, without the tips that have none."""
        return self.session.robot.for_tips({tip: T for tip, T in targets.items() if T is not None})

    def _solve(self) -> None:
        target = self._typed()
        self.found.hide()
        self.say("solving ... (a method's first use compiles it, some seconds)")
        result, left = self.session.solve(target), self.session.followed
        self.show()
        self.stage.gaps(left is not None)
        words, _, advice = (result.message, "", "") if left is None else result.message.partition("; ")
        near = "" if left is None else f" {as_sentence(left.message)}"
        self.say(f"{as_sentence(words)}{near}", GOOD if result.success else BAD)
        self._show_figures(advice)
        self.chart.show(result)

    def _show_figures(self, advice: str = "") -> None:
        self.outcome.content, self.outcome.visible = table_html(self.session.figures()) + note_html(advice), True

    def _hide_answer(self) -> None:
        """Hide the curves of a solve and the list of solutions, which are for another target; not every page has them."""
        if self.chart is not None and self.found is not None:
            self.chart.hide()
            self.found.hide()

    def _dragged(self, patience: int = PATIENCE) -> None:
        """Move towards the dragged targets for a second; then queue another call (at most `patience`) if the arm still moves."""
        targets = {goal.tip: goal.dragged() for goal in self.goals}
        if not self.live:
            return
        found = self.session.follow(self._joined(targets))
        self.show()
        self.stage.gaps(not found.success)
        self.say(as_sentence(found.message), GOOD if found.success else PLAIN)
        self._show_figures()
        self._hide_answer()
        if not found.settled and patience:
            self.worker.post("drag", self._guard(lambda: self._dragged(patience - 1)))

    def _put(self, poses: dict[str, np.ndarray]) -> None:
        """Move the targets to poses by tip."""
        with self.client.atomic():
            for goal in self.goals:
                goal.put(poses[goal.tip])

    def _target_to_tip(self) -> None:
        if self.found is not None:
            self.found.hide()
        self._put(self.session.poses())

    def _random(self) -> None:
        self.found.hide()
        self._put(self.session.random_poses())
        if self.live:
            self._solve()

    def _solve_all(self) -> None:
        s = self.session
        target = self._typed()
        self.outcome.visible = False
        self.say("searching ...")
        words, details = s.solve_all(target)
        self.stage.gaps(False)
        self.found.show(details)
        self.say(as_sentence(words), GOOD if s.solutions else BAD)

    def _pick(self, k: int) -> None:
        s = self.session
        s.q = s.solutions[k].copy()
        self.stage.ghost(None)
        self.show()
        self.say(f"solution {k + 1} of {len(s.solutions)}", GOOD)

    def _show_frames(self, visible: bool) -> None:
        self.frames = visible
        for frame in self.stage.axes:
            frame.visible = visible
