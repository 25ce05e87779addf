"""Solver rules: each makes one step of an iterative method from the error and the Jacobian; the search does everything else.

A rule is a NamedTuple class marked `@rule`. Its fields are its parameters. Its compiled `step(p, e)` writes p.desk.dq (n,) and
returns 0, SINGULAR_STEP (there is no step) or WAITING (a step of zero that is no stall). Where the step reads other numbers than
the parameters, a `@compiled` record has the step, the rule is marked `@rule(step=ThatRecord)`, and its `pack` makes the record.

p is the problem (kernel/problem.py lists its methods) and e the errors at the current configuration: e.ee is their squared norm,
e.good says whether they are inside the tolerances. A rule never tests convergence, counts iterations or clips q; where it evaluates
the chain itself it asks p.desk.affords(n) first and calls p.try_out(q). A record whose step does not read p.desk.J sets JACOBIAN =
False. What else a rule may define is in `protocol.Rule`.
"""
