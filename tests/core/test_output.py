"""Commands that begin in the same second have a folder each."""

from pathlib import Path

import hydra
import pytest

from softrl.core.output import TWIN_VARIABLE, claim

CONF = Path(__file__).resolve().parents[2] / "conf"


@pytest.mark.parametrize("kind", ["run", "sweep"])
def test_a_folder_that_is_taken_is_left_to_its_owner(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(TWIN_VARIABLE, "-7")  # of a command that started this one
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        node = hydra.compose("config", ["stage=mesh"], return_hydra_config=True).hydra[kind]
    found = []
    for _ in range(3):
        claim(node)
        found.append(node.dir)
    assert found == [found[0], f"{found[0]}-2", f"{found[0]}-3"]
    assert all(Path(folder).is_dir() and Path(folder).parent.name == "mesh" for folder in found)
    assert Path(found[0]).name.count("-") == 4, "the usual name is the time alone"


def test_a_folder_that_the_user_named_is_used_again(tmp_path: Path) -> None:
    named = f"hydra.run.dir={tmp_path}/mine"
    with hydra.initialize_config_dir(str(CONF), version_base="1.3"):
        node = hydra.compose("config", ["stage=mesh", named], return_hydra_config=True).hydra.run
    for _ in range(2):
        claim(node)
        assert node.dir == f"{tmp_path}/mine" and [path.name for path in tmp_path.iterdir()] == ["mine"]
