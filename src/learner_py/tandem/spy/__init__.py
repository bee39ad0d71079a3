"""What `./tandem spy` shows, live from LCM or from an event log.

    source (live, recording) ─▶ Batch ─▶ Model (model) ─▶ channel_table, robot_page, learning_page ─▶ app, once
                                           └ Channel (channel): count, rate, jitter, gaps, latency

A source hands over undecoded messages; the model counts them by their first bytes and decodes only what is shown.
"""
