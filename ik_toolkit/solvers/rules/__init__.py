"""Rules: one step of an iterative method each. A rule reads error and Jacobian and writes dq; the search does the rest.

A rule is a `@compiled` NamedTuple class: its fields are its parameters, `pack(robot)` returns the record the kernel gets (itself,
or one made of the parameters; then the class says `COMPILED = ThatClass`), and `step(p, e)` writes p.desk.dq (n,) and returns
0, SINGULAR_STEP (there is no step) or WAITING (a step of zero that is no stall). p is the problem (kernel/problem.py lists its
calls), e the look at the current configuration: e.ee is the squared norm of the errors, e.good says whether they are inside the
tolerances. A rule never tests convergence, counts or clips; where it evaluates the chain itself it asks p.desk.affords(n) first
and calls p.try_out(q). Class attributes: JACOBIAN = False of a record whose step reads no p.desk.J; of the rule, hold = True
redoes a step without the joints it would push past a limit, and wrap = True lets a bounded joint with a full turn or more go on
from the other end of its range.
"""
