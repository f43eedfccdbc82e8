"""Many runs of one family of grasps, in chunks of fixed size; folders from which a sweep can be resumed.

`_sweep` has the public function: it cuts the parameters into chunks and hands these to worker threads.
`_program` traces and compiles what one chunk does. Where a folder or a store is given, `_identity` gathers
the digests (`_fingerprint`) that tell one sweep from another, `_folder` reads and writes the finished chunks,
and `_store` writes them to a table that xarray opens. Where other processes compute, `_dispatch` sends them
chunks, `_sending` is what they do with these, and `_identity` tells whether they are like this process.
`_parameters` has the parameters of many runs by name.
"""

from ._parameters import Parameters as Parameters
from ._program import answer as answer, as_now as as_now
from ._sweep import sweep as sweep
