from .page import SCRIPTS as SCRIPTS
from .page import explorer_page as explorer_page
from .page import script as script

__all__: list[str]
