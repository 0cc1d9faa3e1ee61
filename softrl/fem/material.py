"""Hyperelastic materials: each is a small class of moduli and the compiled law that reads them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Protocol

import numpy as np

from softrl.core.errors import ConfigError
from softrl.fem.law import corotational, mooney_rivlin, st_venant_kirchhoff, stable_neo_hookean, yeoh


class Material(Protocol):
    """A law of the elastic energy density W(F), with F the deformation gradient."""

    kernel: ClassVar[Any]

    @property
    def youngs_modulus_pa(self) -> float:
        """Young's modulus at rest."""
        ...

    @property
    def poisson(self) -> float:
        """Poisson's ratio at rest."""
        ...

    def pack(self) -> np.ndarray:
        """Return the parameter vector that the kernel reads."""
        ...

    def split(self) -> tuple[np.ndarray, float]:
        """Return (parameters, k) such that W is the kernel's energy under ``parameters`` plus k/2 (J - 1)^2.

        k is zero where the law has no such part.
        """
        ...


def lame(youngs_modulus: float, poisson: float) -> tuple[float, float]:
    """Return the Lame constants (lambda, mu) in the unit of ``youngs_modulus``."""
    mu = youngs_modulus / (2.0 * (1.0 + poisson))
    return 2.0 * mu * poisson / (1.0 - 2.0 * poisson), mu


def bulk_modulus(shear_modulus: float, poisson: float) -> float:
    """Return kappa in the unit of ``shear_modulus``."""
    return 2.0 * shear_modulus * (1.0 + poisson) / (3.0 * (1.0 - 2.0 * poisson))


def _check(material: Any) -> None:
    """Raise unless Young's modulus is positive and Poisson's ratio lies in [0, 0.495]."""
    name = type(material).__name__
    for field in fields(material):
        if field.name == "poisson" and not 0.0 <= material.poisson <= 0.495:
            raise ConfigError(
                f"material {name}.poisson={material.poisson:g} is outside 0..0.495; "
                "quadratic tetrahedra lock above 0.495, use a value such as 0.45"
            )
    if not material.youngs_modulus_pa > 0:
        raise ConfigError(f"material {name}: Young's modulus {material.youngs_modulus_pa:g} Pa must be positive")


@dataclass(frozen=True)
class _Hookean:
    """A law of Young's modulus and Poisson's ratio that weighs the trace of its strain."""

    youngs_modulus_pa: float
    poisson: float

    def __post_init__(self) -> None:
        _check(self)

    def pack(self) -> np.ndarray:
        """Return (lambda, mu) in Pa."""
        return np.array(lame(self.youngs_modulus_pa, self.poisson))

    def split(self) -> tuple[np.ndarray, float]:
        """Return (parameters, 0 Pa): this law weighs the trace of its strain, not J."""
        return self.pack(), 0.0


@dataclass(frozen=True)
class StableNeoHookean(_Hookean):
    """Neo-Hookean law that stays finite for inverted elements (Smith, De Goes, Kim 2018; no number checked)."""

    kernel: ClassVar = stable_neo_hookean

    def split(self) -> tuple[np.ndarray, float]:
        """Return ((-2/3 mu, mu), bulk modulus) in Pa: what stays behind must not gain from a change of volume."""
        lam, mu = self.pack()
        return np.array([-2.0 / 3.0 * mu, mu]), float(lam + 2.0 / 3.0 * mu)


@dataclass(frozen=True)
class StVenantKirchhoff(_Hookean):
    """Linear law between Green strain and second Piola-Kirchhoff stress; softens and fails in compression."""

    kernel: ClassVar = st_venant_kirchhoff


@dataclass(frozen=True)
class Corotational(_Hookean):
    """Hooke's law in the frame of the polar decomposition of each F: large rotations, small strains."""

    kernel: ClassVar = corotational


@dataclass(frozen=True)
class _Isochoric(ABC):
    """A law of isochoric invariants, with a bulk modulus that weighs J; its parameters end with that."""

    def __post_init__(self) -> None:
        _check(self)

    @abstractmethod
    def pack(self) -> np.ndarray:
        """Return the moduli and kappa in Pa."""

    def split(self) -> tuple[np.ndarray, float]:
        """Return ((moduli, 0), kappa) in Pa."""
        *moduli, kappa = self.pack()
        return np.array([*moduli, 0.0]), float(kappa)


@dataclass(frozen=True)
class Yeoh(_Isochoric):
    """Yeoh's cubic law in the isochoric first invariant, with a bulk modulus from ``poisson``."""

    kernel: ClassVar = yeoh
    c1_pa: float
    c2_pa: float
    c3_pa: float
    poisson: float

    @property
    def youngs_modulus_pa(self) -> float:
        """Young's modulus at rest, from the shear modulus 2 c1."""
        return 4.0 * self.c1_pa * (1.0 + self.poisson)

    def pack(self) -> np.ndarray:
        """Return (c1, c2, c3, kappa) in Pa."""
        return np.array([self.c1_pa, self.c2_pa, self.c3_pa, bulk_modulus(2.0 * self.c1_pa, self.poisson)])


@dataclass(frozen=True)
class MooneyRivlin(_Isochoric):
    """Two-term Mooney-Rivlin law in isochoric invariants, with a bulk modulus from ``poisson``."""

    kernel: ClassVar = mooney_rivlin
    c10_pa: float
    c01_pa: float
    poisson: float

    @property
    def youngs_modulus_pa(self) -> float:
        """Young's modulus at rest, from the shear modulus 2 (c10 + c01)."""
        return 4.0 * (self.c10_pa + self.c01_pa) * (1.0 + self.poisson)

    def pack(self) -> np.ndarray:
        """Return (c10, c01, kappa) in Pa."""
        return np.array([self.c10_pa, self.c01_pa, bulk_modulus(2.0 * (self.c10_pa + self.c01_pa), self.poisson)])


LAWS: dict[str, type] = {
    "stable_neo_hookean": StableNeoHookean,
    "st_venant_kirchhoff": StVenantKirchhoff,
    "corotational": Corotational,
    "yeoh": Yeoh,
    "mooney_rivlin": MooneyRivlin,
}


def material_of(law: str, moduli_pa: Sequence[float], poisson: float) -> Material:
    """Return the material ``law`` with its moduli in the order of its fields.

    Raises
    ------
    ConfigError
        If the law is unknown or the number of moduli is not the law's.
    """
    if law not in LAWS:
        raise ConfigError(f"law={law} is unknown; expected one of {', '.join(LAWS)}")
    names = [field.name for field in fields(LAWS[law]) if field.name != "poisson"]
    if len(moduli_pa) != len(names):
        raise ConfigError(
            f"moduli_pa={list(moduli_pa)} holds {len(moduli_pa)} values; law {law} takes {', '.join(names)}"
        )
    return LAWS[law](*moduli_pa, poisson)
