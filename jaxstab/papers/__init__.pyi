from .claim import Claim as Claim
from .claim import Finding as Finding
from .claim import markdown as markdown
from .claims import CLAIMS as CLAIMS

__all__: list[str]
