"""The page of `ik view --follow`: the robot and its target to drag, without the panel's controls."""

from contextlib import nullcontext
from typing import Any

from .page import PanelPage
from .target_widget import Goal


class Follower(PanelPage):
    """One visitor's page: the target's fields, the status line and the view."""

    def _build_controls(self) -> None:
        self.sliders: list[Any] = []
        self.status = self.gui.add_html("")
        self.goals = []
        several = len(self.session.robot.tips) > 1
        for tip in self.session.robot.tips:
            with self.gui.add_folder(tip) if several else nullcontext():
                self.goals.append(Goal(self.gui, self.session, tip, self.kinds.get(tip, self.session.kind), self._on))
        home = self.gui.add_button("Reset to home")
        self._on(home, "joints", self._home)
        self.outcome = self.gui.add_html("", visible=False)
        self.pose = self.gui.add_html("")

    def _home(self) -> None:
        s = self.session
        s.q, s.followed = s.robot.home.copy(), None
        self.outcome.visible = False
        self.show()
        self._target_to_tip()
        self.say("at home")
