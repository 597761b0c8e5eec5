from .delay_margin import DelayMargin as DelayMargin
from .delay_margin import DelayStatus as DelayStatus
from .delay_margin import delay_margin as delay_margin
from .frequency import Reading as Reading
from .frequency import frequency_response as frequency_response
from .frequency import readings as readings
from .line import Interval as Interval
from .line import LineStatus as LineStatus
from .line import StableLine as StableLine
from .line import stable_line as stable_line
from .roots import Number as Number
from .roots import Poles as Poles
from .roots import poles as poles
from .roots import rough_radius as rough_radius
from .roots import spectral_radius as spectral_radius
from .small_gain import SmallGainStatus as SmallGainStatus
from .small_gain import largest_jitter as largest_jitter
from .small_gain import small_gain as small_gain
from .verdict import TripleAt as TripleAt
from .verdict import VerdictStatus as VerdictStatus
from .verdict import WallVerdict as WallVerdict
from .verdict import wall_verdict as wall_verdict

__all__: list[str]
