"""The public names, one a line, each with its module. `__init__.py` reads this file."""

from lagrange.compiler import load as load
from lagrange.errors import LagrangeError as LagrangeError
from lagrange.errors import RunError as RunError
from lagrange.errors import SceneError as SceneError
from lagrange.errors import StatementError as StatementError
from lagrange.evidence.trust import TrustHorizon as TrustHorizon
from lagrange.evidence.trust import trust_horizon as trust_horizon
from lagrange.export.target import targets as targets
from lagrange.members.varied import grid as grid
from lagrange.members.varied import sample as sample
from lagrange.recipes.model import Model as Model
from lagrange.show import methods as methods
from lagrange.show.dynamics import bifurcation as bifurcation
from lagrange.show.dynamics import phase_portrait as phase_portrait
from lagrange.show.dynamics import poincare as poincare
from lagrange.show.ensemble import Ensemble as Ensemble
from lagrange.show.ensemble import ensemble as ensemble
from lagrange.show.figures.new_figure import figure as figure
from lagrange.show.figures.run_figure import plot as plot
from lagrange.show.notebook.shown_lists import scenes as scenes
from lagrange.show.race import Race as Race
from lagrange.show.race import race as race
from lagrange.statement.contact import contact as contact
from lagrange.statement.contact import contacts_between as contacts_between
from lagrange.statement.contact import gap as gap
from lagrange.statement.contact import impact_speed as impact_speed
from lagrange.statement.coordinate import coordinate as coordinate
from lagrange.statement.coordinate import coordinates as coordinates
from lagrange.statement.coordinate import multiplier as multiplier
from lagrange.statement.coordinate import parameters as parameters
from lagrange.statement.coordinate import t as t
from lagrange.statement.energy import gravity as gravity
from lagrange.statement.energy import kinetic_energy as kinetic_energy
from lagrange.statement.energy import rotational_energy as rotational_energy
from lagrange.statement.energy import spring as spring
from lagrange.statement.event import Event as Event
from lagrange.statement.event import event as event
from lagrange.statement.given.function import given as given
from lagrange.statement.given.motion import table as table
from lagrange.system import System as System
from lagrange.system import scene as scene
from lagrange.trajectory.integrator import Claims as Claims
from lagrange.trajectory.integrator import Integrator as Integrator
from lagrange.trajectory.integrator import Problem as Problem
from lagrange.trajectory.run import flow as flow
from lagrange.trajectory.run import integrate as integrate
from lagrange.trajectory.solution import Solution as Solution
from lagrange.trajectory.trajectory import Status as Status
from lagrange.trajectory.trajectory import Trajectory as Trajectory

__all__: list[str]
__version__: str
