"""Ways that friction and motors allow, and how a parcel follows one."""
