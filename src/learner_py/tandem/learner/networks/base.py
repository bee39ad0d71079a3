"""What all heads share: the type of their configs, and the activations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field

Array = jax.Array
Params = Any  # dicts and lists of arrays; the path to an array is its name in the policy file
Images = dict[str, Array]  # camera -> (B, H, W, 3) uint8, RGB

Activation = Literal["relu", "tanh", "gelu"]
ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "relu": jax.nn.relu,
    "tanh": jnp.tanh,
    "gelu": lambda x: jax.nn.gelu(x, approximate=True),  # the tanh form, as in the policy runtime
}

Width = Annotated[int, Field(ge=1, le=4096)]
Hidden = Annotated[
    tuple[Width, ...], Field(max_length=8, strict=False)
]  # sizes of hidden layers; JSON has lists
Horizon = Annotated[int, Field(ge=1, le=256)]
LogStd = Annotated[float, Field(ge=-20, le=5)]


class HeadConfig(BaseModel):
    """The structure of a network, within the limits of the policy runtime. Its JSON dump is what the policy file calls
    "config"; frozen, so that a jitted function can be kept per config."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


def array(values: ArrayLike) -> Array:
    """A parameter in float32. Made of NumPy's numbers: JAX would compile a program for every shape it fills."""
    return jnp.asarray(np.asarray(values, np.float32))


def zeros(n: int) -> Array:
    return array(np.zeros(n))


def ones(n: int) -> Array:
    return array(np.ones(n))
