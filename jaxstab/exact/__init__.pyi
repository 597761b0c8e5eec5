from .line import Interval as Interval
from .line import LineStatus as LineStatus
from .line import StableLine as StableLine
from .line import stable_line as stable_line
from .margins import DelayMargin as DelayMargin
from .margins import DelayStatus as DelayStatus
from .margins import Reading as Reading
from .margins import Readings as Readings
from .margins import SmallGainStatus as SmallGainStatus
from .margins import delay_margin as delay_margin
from .margins import frequency_response as frequency_response
from .margins import largest_jitter as largest_jitter
from .margins import readings as readings
from .margins import small_gain as small_gain
from .roots import Number as Number
from .roots import Poles as Poles
from .roots import TripleAt as TripleAt
from .roots import VerdictStatus as VerdictStatus
from .roots import WallVerdict as WallVerdict
from .roots import poles as poles
from .roots import rough_radius as rough_radius
from .roots import spectral_radius as spectral_radius
from .roots import wall_verdict as wall_verdict
from .rows import row_codes as row_codes

__all__: list[str]
