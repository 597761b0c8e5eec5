from .robot import JointAnswer as JointAnswer
from .robot import Joints as Joints
from .robot import Together as Together
from .robot import joints as joints
from .robot import read_gains as read_gains

__all__: list[str]
