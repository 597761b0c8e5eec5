from .trace import BoundaryTrace as BoundaryTrace
from .trace import TraceStatus as TraceStatus
from .trace import trace_boundary as trace_boundary

__all__: list[str]
