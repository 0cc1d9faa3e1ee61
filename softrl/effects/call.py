"""Calls of effects from compiled code: kernels by address, parameters and states in flat arrays.

A typed list of functions costs more per element than most kernels do; an address in an integer array costs nothing.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numba as nb
import numpy as np
from llvmlite import ir
from numba.core import cgutils
from numba.extending import intrinsic

from softrl.core.compiled import borrowing
from softrl.core.simulator import Hook
from softrl.effects.effect import PORT_KERNEL, SIGNAL_KERNEL


class Calls(NamedTuple):
    """Kernels in the order in which they are called.

    Attributes
    ----------
    kernels : (k,) addresses
    at : (k + 1, 2) where the parameters and the state of each kernel begin, and where the last ones end
    parameters, states : all kernels' joined; states are advanced in place
    """

    kernels: np.ndarray
    at: np.ndarray
    parameters: np.ndarray
    states: np.ndarray


def pack(hooks: Sequence[Hook]) -> Calls:
    """Return ``hooks`` as compiled code takes them; their states are copied."""
    at = np.zeros((len(hooks) + 1, 2), dtype=np.int64)
    for k, hook in enumerate(hooks):
        at[k + 1] = at[k, 0] + len(hook.parameters), at[k, 1] + len(hook.state)
    empty = [np.zeros(0)]
    return Calls(
        np.array([address_of(hook.kernel) for hook in hooks], dtype=np.int64),
        at,
        np.concatenate([hook.parameters for hook in hooks] or empty),
        np.concatenate([hook.state for hook in hooks] or empty),
    )


def unpack(calls: Calls, hooks: Sequence[Hook]) -> None:
    """Copy the states of ``calls`` back into ``hooks``."""
    for hook, first, end in zip(hooks, calls.at[:-1, 1], calls.at[1:, 1], strict=True):
        hook.state[:] = calls.states[first:end]


_ADDRESSES: dict[int, tuple[Any, int]] = {}


def address_of(kernel: Any) -> int:
    """Return where the machine code of a compiled kernel stands; the kernel is kept alive with it."""
    if id(kernel) not in _ADDRESSES:
        compiled = kernel.overloads[kernel.signatures[0]]
        address = compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)
        _ADDRESSES[id(kernel)] = (kernel, address)
    return _ADDRESSES[id(kernel)][1]


def _code(signature: Any) -> Any:
    """Return the generator of a call of the address in the first argument with the arguments after it."""

    def codegen(context: Any, builder: Any, _: Any, arguments: Sequence[Any]) -> Any:
        convention = context.call_conv
        pointer = convention.get_function_type(signature.return_type, signature.args).as_pointer()
        function = builder.inttoptr(arguments[0], pointer)
        status, _ = convention.call_function(
            builder, function, signature.return_type, signature.args, list(arguments[1:])
        )
        with cgutils.if_unlikely(builder, status.is_error):  # type: ignore[no-untyped-call]
            convention.return_status_propagate(builder, status)
        return ir.Constant(ir.IntType(8).as_pointer(), None)

    return codegen


def _call_port_type(_: Any, address: Any, parameters: Any, state: Any, port: Any, dt: Any, commit: Any) -> Any:
    return nb.void(nb.int64, *PORT_KERNEL.args), _code(PORT_KERNEL)


def _call_signal_type(_: Any, address: Any, parameters: Any, state: Any, value: Any, dt: Any) -> Any:
    return nb.void(nb.int64, *SIGNAL_KERNEL.args), _code(SIGNAL_KERNEL)


call_port: Any = intrinsic(_call_port_type)
call_signal: Any = intrinsic(_call_signal_type)


@borrowing
def run_ports(calls: Any, port: np.ndarray, dt: float, commit: bool) -> None:
    """Run every kernel on a body's or a load's port, in order."""
    kernels, at, parameters, states = calls
    for k in range(len(kernels)):
        mine, state = parameters[at[k, 0] : at[k + 1, 0]], states[at[k, 1] : at[k + 1, 1]]
        call_port(kernels[k], mine, state, port, dt, commit)


@borrowing
def run_signals(calls: Any, flows: np.ndarray, values: np.ndarray, ends: np.ndarray, apart: bool, dt: float) -> bool:
    """Run every kernel over each row of ``values`` (steps, n), in order, in place; return whether ``ends`` are apart from these.

    ``ends`` (steps, n) are what there is at the steps' ends, or nothing yet where they are not ``apart``: from the first kernel
    on that ``flows`` they are.
    """
    kernels, at, parameters, states = calls
    for k in range(len(kernels)):
        mine, state = parameters[at[k, 0] : at[k + 1, 0]], states[at[k, 1] : at[k + 1, 1]]
        if flows[k] and not apart:
            for step in range(len(values)):
                for i in range(values.shape[1]):
                    ends[step, i] = values[step, i]
            apart = True
        for step in range(len(values)):
            call_signal(kernels[k], mine, state, values[step], dt)
            if apart:
                call_signal(kernels[k], mine, state, ends[step], 0.0)
    return apart
