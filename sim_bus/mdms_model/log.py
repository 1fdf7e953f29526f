"""The logger of the packages: its warnings go to stderr, as long as nobody sets up logging."""

import logging

LOG = logging.getLogger("mdms")
