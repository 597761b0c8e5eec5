from .line import Interval as Interval
from .line import LineStatus as LineStatus
from .line import StableLine as StableLine
from .line import stable_line as stable_line
from .margins import DelayMargin as DelayMargin
from .margins import DelayStatus as DelayStatus
from .margins import Reading as Reading
from .margins import SmallGainStatus as SmallGainStatus
from .margins import delay_margin as delay_margin
from .margins import frequency_response as frequency_response
from .margins import largest_jitter as largest_jitter
from .margins import readings as readings
from .margins import small_gain as small_gain
from .poles import Number as Number
from .poles import Poles as Poles
from .poles import TripleAt as TripleAt
from .poles import VerdictStatus as VerdictStatus
from .poles import WallVerdict as WallVerdict
from .poles import poles as poles
from .poles import rough_radius as rough_radius
from .poles import spectral_radius as spectral_radius
from .poles import wall_verdict as wall_verdict

__all__: list[str]
