"""The live page: the table in a browser, and the commands of a person there."""
