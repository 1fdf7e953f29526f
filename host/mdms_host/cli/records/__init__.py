"""What runs leave behind: run folders written, drawn, exported; bus logs written and read."""
