"""Many records of one frame: their modes, and the one measurement file that they make."""

from cvxshear.campaign.files import record_files
from cvxshear.campaign.many import IdentifiedRecord, identify_modes_many
from cvxshear.campaign.merge import merged, write_merged

__all__ = ["IdentifiedRecord", "identify_modes_many", "merged", "record_files", "write_merged"]
