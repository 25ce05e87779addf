# coal, the collision library under Pinocchio, is a compiled module without type information too.
from typing import Any

def __getattr__(name: str) -> Any: ...
