"""Many runs, in chunks; folders that say whose they are."""

from ._sweep import sweep as sweep
