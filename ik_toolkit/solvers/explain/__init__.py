"""How a solution comes about, for people: what `Result.explain()` returns."""
