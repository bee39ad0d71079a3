"""Event logs in the formats of other tools; one file a format, docs/EXPORT.md shows each.

    source = open_source(log, numbers="3-10", phase="training")
    lerobot.write(source, path)   # likewise mcap, rerun, table

Every writer makes its file or folder whole or not at all.
"""
