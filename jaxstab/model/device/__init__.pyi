from .device import Device as Device
from .device import Hand as Hand
from .parts import Mode as Mode

__all__: list[str]
