"""What type checkers see of the public names, which load on first use (a test holds this to `__init__.py`)."""

from .errors import IKError as IKError
from .errors import NotSolved as NotSolved
from .paths.result import PathResult as PathResult
from .paths.result import PathStatus as PathStatus
from .paths.trajectory import Trajectory as Trajectory
from .robot.collision import CollisionModel as CollisionModel
from .robot.pose import pose as pose
from .robot.robot import Robot as Robot
from .robot.tree import Tree as Tree
from .show.scene import view as view
from .solvers.batch import solve_batch as solve_batch
from .solvers.batch_result import BatchCheckFailed as BatchCheckFailed
from .solvers.closed_form.inspection import Inspection as Inspection
from .solvers.closed_form.planar_2r import Planar2R as Planar2R
from .solvers.prepare import prepare as prepare
from .solvers.protocol import closed_form as closed_form
from .solvers.protocol import rule as rule
from .solvers.result import Result as Result
from .solvers.rules.ccd import CCD as CCD
from .solvers.rules.jacobian import DLS as DLS
from .solvers.rules.jacobian import LM as LM
from .solvers.rules.jacobian import Newton as Newton
from .solvers.rules.jacobian import Pinv as Pinv
from .solvers.rules.jacobian import Transpose as Transpose
from .solvers.rules.pid import PID as PID
from .solvers.rules.state_space import StateSpace as StateSpace
from .solvers.solve import Solver as Solver
from .solvers.solve import solve as solve
from .solvers.solve_all import solve_all as solve_all
from .solvers.status import Status as Status
from .study.benchmark import benchmark as benchmark
from .study.tune import tune as tune
from .study.workspace import workspace as workspace
from .tracking.reference import Reference as Reference
from .tracking.result import TrackResult as TrackResult
from .tracking.shapes import circle as circle
from .tracking.shapes import line as line
from .tracking.shapes import lissajous as lissajous
from .tracking.stability import best_gains as best_gains
from .tracking.stability import check_gains as check_gains
from .tracking.track import track as track
from .tracking.tracker import Tracker as Tracker
from .tracking.waypoints import reference_from_file as reference_from_file
from .tracking.waypoints import waypoints as waypoints

__version__: str
