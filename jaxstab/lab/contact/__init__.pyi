from .runs import Contact as Contact
from .runs import ContactKind as ContactKind
from .runs import contact as contact
from .runs import setup_of as setup_of
from .table import contact_table as contact_table
from .table import plan_contacts as plan_contacts

__all__: list[str]
