from .device import Device as Device
from .device import Hand as Hand
from .parts import Mode as Mode
from .sampling import SampledDevice as SampledDevice
from .sampling import sampled_device as sampled_device

__all__: list[str]
