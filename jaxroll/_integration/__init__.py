"""From a closed state to a trajectory: steps, their lengths, events, batches and derivatives.

`_simulate` is the entry point; `_arguments` and `_methods` check what it is given, and `_run_options` keeps
most of it for callers who run later. `_state_vector` lays a state out as one vector, `_bundle` the numbers of
a grasp as one; `_step` makes one step of a method of diffrax on it (`_rosenbrock` is a linearly implicit
method), `_step_size` sets its length, `_events` determines where the model ends, within a step too. `_run`
takes steps until a run is over, `_batch` takes those of many runs together, `_derivative` differentiates the
recorded steps, backwards by `_backward_step`. `_jumps` has the steps at declared jumps, `_strike` a blow by
itself, `_contact_impulses` the blows of a run, `_resume` what follows a lost contact or a touch.
`_trajectory` is the result, `_dense` reads it between its saved times, `_dataset` makes a table for xarray of
it, and `_report` is its printed form.
`_vector_field` and `_projected_method` offer the same equations, those of `_motion`, to diffrax's own
`diffeqsolve`.
"""

from ._arguments import (
    check_choices as check_choices,
    check_times as check_times,
    ProgressMeter as ProgressMeter,
    RECORDS as RECORDS,
    RTOL as RTOL,
    save_times as save_times,
    Solver as Solver,
    StepSizeControl as StepSizeControl,
    tolerance as tolerance,
)
from ._dataset import (
    about as about,
    as_dataset as as_dataset,
    flag_words as flag_words,
    label_arrays as label_arrays,
    Named as Named,
    named_arrays as named_arrays,
    open_table as open_table,
    xarray_module as xarray_module,
)
from ._events import FLAT as FLAT, link_distances as link_distances, SINGULAR as SINGULAR
from ._report import (
    amount as amount,
    cause as cause,
    complaint as complaint,
    contact_name as contact_name,
    REMEDIES as REMEDIES,
    report as report,
)
from ._resume import resume as resume
from ._rosenbrock import Rosenbrock as Rosenbrock
from ._run_options import RunOptions as RunOptions
from ._simulate import simulate as simulate
from ._state_vector import layout as layout, pack as pack, unpack as unpack
from ._strike import Strike as Strike, strike as strike
from ._trajectory import check_one_run as check_one_run, Trajectory as Trajectory
from ._vector_field import vector_field as vector_field, VectorField as VectorField
