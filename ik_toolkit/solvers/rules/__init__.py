"""Rules: one step of an iterative method each. A rule reads error and Jacobian and writes dq; the search does the rest.

A rule is a NamedTuple class marked `@rule`: its fields are its parameters, and `step(p, e)`, compiled, writes p.desk.dq (n,) and
returns 0, SINGULAR_STEP (there is no step) or WAITING (a step of zero that is no stall). Where the step reads other numbers than
the parameters, a `@compiled` record has the step, the rule is marked `@rule(step=ThatRecord)`, and its `pack` makes the record.

p is the problem (kernel/problem.py lists its calls), e the look at the current configuration: e.ee is the squared norm of the
errors, e.good says whether they are inside the tolerances. A rule never tests convergence, counts or clips; where it evaluates
the chain itself it asks p.desk.affords(n) first and calls p.try_out(q). A record whose step reads no p.desk.J says JACOBIAN =
False. What else a rule may say is in `protocol.Rule`.
"""
