"""Records of pictures, scenes, signatures and texts: what they were when someone last looked at them.

A record says only that nothing has changed. It notices what no check of a formula does: a camera that looks
from elsewhere, a legend that lacks an entry, another length of a link. What can be checked against something
independent is, beside the records, in the same test files.

`pictures` draws on small runs (`runs`) that are made by formulas, so that nothing is simulated and no
rounding error is drawn; `artists` puts a figure of matplotlib in words. `scene_numbers`, `signatures` and
`texts` need no figure. `compare` says what differs, number by number with a tolerance, and by name. Each
record is a file of `tests/recorded/records/`. To write them anew, after looking at what has changed:

    python -m tests.recorded            # says what differs
    python -m tests.recorded --write    # takes what is now as the record
"""
