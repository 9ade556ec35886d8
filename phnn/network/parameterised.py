"""The parameters and learned laws of a network as a torch module."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

from phnn.laws import FACTOR_LAWS
from phnn.laws.diverged import check_weights
from phnn.network.bounded import BoundedParameters
from phnn.network.checks import Present, check_module, check_name, present_of
from phnn.network.elements import Network, check_laws


class ParameterisedNetwork(nn.Module):
    """The parameters of a network and those of its laws that are modules, to be trained or held.

    Its attributes and what it refuses are those of `phnn.network.system.PortHamiltonianSystem`.
    """

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network
        self.constants = nn.Module()
        self.laws = nn.ModuleDict()
        for name, parameter in network.parameters.items():
            check_name(name, self.constants if parameter.fixed else nn.ParameterDict())
            if parameter.fixed:
                self.constants.register_buffer(name, torch.tensor(parameter.value, dtype=torch.float64))
        self.free = BoundedParameters({n: p for n, p in network.parameters.items() if not p.fixed})
        self._present: Present = None
        check_laws(network)
        for kind, elements in (("storage", network.storages), ("resistor", network.resistors)):
            for element in elements:
                if not isinstance(element.law, str):
                    key = f"{kind}_{element.name}"
                    check_module(kind, element)
                    check_name(key, self.laws)
                    self.laws[key] = element.law
        place = {name: k for k, name in enumerate(network.state_names)}
        self._factors = tuple((place[m.by], m) for m in network.modulations)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the energy variables and then the modulator states, in the order of ``x``."""
        return self.network.state_names

    def value(self, name: str) -> Tensor:
        """() present value of a parameter [SI]."""
        if name not in self.free:
            return getattr(self.constants, name)
        # Kept for the time of one evaluation only: from a tensor kept longer the adjoint method would get no gradient.
        present = present_of(self)
        return self.free.value(name) if present is None else present[name]

    def set_values(self, values: Mapping[str, float]) -> None:
        """Set parameters that are not fixed [SI]; of fixed ones build the network with other values.

        Raises:
            InputRefused: an unknown or fixed name, or a value that is not finite or outside the parameter's bounds.
        """
        self.free.assign(values)

    def present_values(self) -> dict[str, Tensor]:
        """Values of all free parameters, once they and all weights have been found finite.

        Raises:
            SolverFailed: one is not; names it.
        """
        for key, law in self.laws.items():
            check_weights(law, f"{key}.")
        return self.free.values()

    def ratios(
        self,
        x: Tensor,  # (..., n) state that modulated ratios read
    ) -> Callable[[str], Tensor]:
        """The function from a ratio's name to its value (...) at a state."""

        def ratio(name: str) -> Tensor:
            value = self.value(name)
            for place, m in self._factors:
                if m.ratio == name:
                    value = value * FACTOR_LAWS[m.law].factor(x[..., place], *map(self.value, m.parameters))
            return value

        return ratio

    def as_network(self) -> Network:
        """The network with the present parameter values."""
        return self.network.with_values({name: value.item() for name, value in self.present_values().items()})
