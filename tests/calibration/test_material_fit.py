"""The closed-form stresses obey mechanics; the fits find known parameters, and the reader refuses bad files."""

from pathlib import Path

import numpy as np
import pytest

from softrl.calibration.material_fit import LAWS, best_fit, fit_materials, in_words, nominal_stress
from softrl.calibration.tensile import TensileCurve, read_tensile
from softrl.core.errors import ConfigError, RecordingError

ROOT = Path(__file__).resolve().parents[2]
KNOWN = {
    "neo_hookean": {"mu_pa": 4e5},
    "mooney_rivlin": {"c1_pa": 1.5e5, "c2_pa": 0.5e5},
    "yeoh": {"c1_pa": 2e5, "c2_pa": -1e3, "c3_pa": 600.0},
}


def energy(law: str, parameters: dict[str, float], principal: np.ndarray) -> float:
    """Return W in J/m^3 at principal stretches (3,), written out from the textbook, not from the code under test."""
    first = (principal**2).sum() - 3.0
    second = (principal**-2.0).sum() - 3.0
    values = list(parameters.values())
    if law == "neo_hookean":
        return 0.5 * values[0] * first
    if law == "mooney_rivlin":
        return values[0] * first + values[1] * second
    return values[0] * first + values[1] * first**2 + values[2] * first**3


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("mode", "exponents"), [("uniaxial", (1, -0.5, -0.5)), ("equibiaxial", (1, 1, -2)), ("planar", (1, 0, -1))]
)
def test_stress_is_the_slope_of_the_energy(law: str, mode: str, exponents: tuple[float, ...]) -> None:
    # an incompressible specimen pulled in k directions by the same stretch takes up k times stress times d stretch
    pulled = sum(e == 1 for e in exponents)
    for stretch in (0.7, 1.0, 1.3, 2.5):
        h = 1e-6
        up, down = (energy(law, KNOWN[law], (stretch + s * h) ** np.array(exponents, dtype=float)) for s in (1, -1))
        stress = nominal_stress(law, KNOWN[law], np.array([stretch]), mode)[0]
        assert stress == pytest.approx((up - down) / (2 * h) / pulled, rel=1e-5, abs=2.0)


@pytest.mark.parametrize("law", LAWS)
def test_fit_finds_the_parameters_that_made_the_curve(law: str) -> None:
    stretch = np.linspace(1.0, 3.0, 200)
    fits = {f.law: f for f in fit_materials(TensileCurve(stretch, nominal_stress(law, KNOWN[law], stretch)), 8)}
    for name, value in KNOWN[law].items():
        assert fits[law].parameters[name] == pytest.approx(value, rel=1e-3)
    assert fits[law].heldout_rms_pa < 1.0
    assert fits[law].stable


def test_neo_hookean_misses_the_stiffening_of_the_shipped_curve() -> None:
    curve = read_tensile(ROOT / "assets/tripod/tensile.csv", 300, 3.0)
    assert 1.0e6 < np.interp(1.15, curve.stretch, curve.stress) / 0.15 < 1.4e6
    fits = {f.law: f for f in fit_materials(curve, 8)}
    assert best_fit(list(fits.values())).law == "yeoh"
    assert fits["yeoh"].heldout_rms_pa < 0.3 * fits["neo_hookean"].heldout_rms_pa


def test_instability_is_told() -> None:
    stretch = np.linspace(1.0, 3.0, 200)
    softening = nominal_stress("yeoh", {"c1_pa": 2e5, "c2_pa": -2.2e4, "c3_pa": 800.0}, stretch)
    fits = fit_materials(TensileCurve(stretch, softening), 8)
    assert not {f.law: f for f in fits}["yeoh"].stable
    assert best_fit(fits).stable


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("strain,force\n1,2\n", "has columns 'strain, force'; expected 'stretch' [-] and 'stress' [kPa]"),
        ("stretch,stress\n" + "1.1,5\n" * 3, "has 3 rows"),
        ("stretch,stress\n" + "1.1,5\n" * 30 + "1.2,abc\n", "line 32: stress='abc'"),
        ("stretch,stress\n" + "1.1,nan\n", "line 2: stress='nan'"),
        ("stretch,stress\n" + "".join(f"{0.02 * i},{30 * i}\n" for i in range(30)), "strain must have 1 added"),
        ("stretch,stress\n" + "".join(f"{1 + 0.02 * i},{1e-3 * i}\n" for i in range(30)), "secant modulus of 0.05 kPa"),
        (
            "stretch,stress\n" + "".join(f"{1 + 0.02 * i},{3e7 * i}\n" for i in range(30)),
            "expected nominal stress in kPa",
        ),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "curve.csv"
    path.write_text(text)
    with pytest.raises(RecordingError) as caught:
        read_tensile(path, 50, 3.0)
    assert told in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_curve_that_begins_beyond_the_range_is_told(tmp_path: Path) -> None:
    path = tmp_path / "prestretched.csv"
    path.write_text("stretch,stress\n" + "".join(f"{2 + 0.02 * i},{700 + 8 * i}\n" for i in range(50)))
    with pytest.raises(RecordingError, match=r"stretch begins at 2, above stage\.stretch_max=1\.5"):
        read_tensile(path, 40, 1.5)


def test_of_a_curve_that_comes_back_the_way_out_counts(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Rubber is softer on the way back; rows in any other order are one curve."""
    out = 1.0 + 0.01 * np.arange(101)
    stress = 300.0 * (out - out**-2)
    both = np.column_stack([np.r_[out, out[::-1]], np.r_[stress, 0.7 * stress[::-1]]])
    curves = []
    for name, rows in {"out": both[:101], "back": both, "mixed": np.random.default_rng(0).permutation(both[:101])}.items():
        np.savetxt(tmp_path / name, rows, delimiter=",", header="stretch,stress", comments="")
        curves.append(read_tensile(tmp_path / name, 50, 3.0))
    for curve in curves[1:]:
        np.testing.assert_allclose(curve.stress, curves[0].stress)
    assert [record.getMessage().split()[0] for record in caplog.records] == [str(tmp_path / "back")]


def test_missing_file_and_too_short_range() -> None:
    with pytest.raises(RecordingError, match="does not exist"):
        read_tensile(Path("nowhere.csv"), 50, 3.0)
    with pytest.raises(ConfigError, match="points of the tensile curve"):
        fit_materials(read_tensile(ROOT / "assets/tripod/tensile.csv", 300, 1.1), 8)


def test_byte_order_mark_and_database_format_are_read(tmp_path: Path) -> None:
    stretch = np.linspace(1.0, 2.0, 50)
    plain, database = tmp_path / "plain.csv", tmp_path / "database.csv"
    plain.write_text("\ufeffstretch,stress\n" + "".join(f"{s},{400 * (s - s**-2)}\n" for s in stretch))
    head = "PARAMETER;INFO;URL;;\nSpeed (mm/min);450;;;\n;;;;\n"
    names = "Time (s);True Strain;True Stress (MPa);Engineering Strain;Engineering Stress (MPa)\n"
    rows = "".join(f"0;0;0;{s - 1};{0.4 * (s - s**-2)}\n" for s in stretch)
    database.write_text(head + names + rows)
    first, second = read_tensile(plain, 40, 3.0), read_tensile(database, 40, 3.0)
    np.testing.assert_allclose(first.stress, second.stress, rtol=1e-6)
    np.testing.assert_allclose(first.stretch, second.stretch, rtol=1e-6)


@pytest.mark.realdata
@pytest.mark.parametrize("stretch_max", [2.0, 3.5])
def test_real_elastomers_stiffen_beyond_neo_hookean(real_data: Path, stretch_max: float) -> None:
    curves = sorted((real_data / "material").glob("*.csv"))
    assert curves, f"no tensile curves in {real_data / 'material'}"
    for path in curves:
        fits = {f.law: f for f in fit_materials(read_tensile(path, 300, stretch_max), 8)}
        assert fits["yeoh"].heldout_rms_pa < 0.75 * fits["neo_hookean"].heldout_rms_pa, path.name
        assert fits["yeoh"].stable, path.name
        assert 10e3 < best_fit(list(fits.values())).initial_youngs_modulus_pa < 5e6, path.name


@pytest.mark.parametrize(
    ("rise", "found"), [(0.0, "suffices"), (0.05, "strain stiffening"), (-0.02, "softening with strain")]
)
def test_what_a_plain_law_misses_is_said(rise: float, found: str) -> None:
    stretch = np.linspace(1.0, 3.0, 200)
    stress = nominal_stress("neo_hookean", {"mu_pa": 4e5}, stretch) * (1.0 + rise * (stretch - 1.0) ** 2)
    noisy = stress + 2e3 * np.random.default_rng(0).standard_normal(200)
    curve = TensileCurve(stretch, noisy)
    assert found in in_words(curve, fit_materials(curve, 8))
