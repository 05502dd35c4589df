"""Forms of effects that a file of MuJoCo can express."""
from typing import Any
FORMS: dict[str, Any] = {}
