"""Sections: one file each, which defines SECTION; the report holds those whose tables are there."""
