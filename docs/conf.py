"""The site: `make docs` builds it from the documents of the whole repository, without a network."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / folder) for folder in ("host", "protocol", "sim_bus", "firmware")]

from mdms_protocol.version import VERSION  # noqa: E402

project = "mdms-array"
copyright = "the mdms-array contributors"
version = release = VERSION

extensions = ["myst_parser", "sphinx.ext.autodoc"]
# Links between documents are relative paths, so the source is the whole repository.
root_doc = "docs/index"
include_patterns = ["*.md", "docs/*.md", "docs/*.rst"]
include_patterns += [f"{folder}/*.md" for folder in ("firmware", "host", "protocol", "sim_bus")]
exclude_patterns = [".*", "build", "runs", "tests", "typings"]

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
suppress_warnings = ["myst.header"]

autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
default_role = "code"

html_theme = "furo"
html_title = f"mdms-array {VERSION}"
html_copy_source = False
html_show_sphinx = False
html_static_path = ["_site"]
html_css_files = ["site.css"]
# The first page lies in docs/, as its source does.
html_additional_pages = {"index": "start.html"}
templates_path = ["_site"]
html_theme_options = {"navigation_with_keys": True}
