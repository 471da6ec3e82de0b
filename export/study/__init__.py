"""The reproduction study: the thesis's tables and figures measured again, each by its command."""
