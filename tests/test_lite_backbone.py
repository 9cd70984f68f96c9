"""The ImageNet backbone: normalisation folded right, strides, what is frozen, what moves slowly. Random weights."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from leadline.training.lite import BLOCKS, EPSILON, FROZEN, STRIDE_8, Lite  # noqa: E402
from leadline.training.network import Network  # noqa: E402
from leadline.training.train import LEARNT_PACE, _groups  # noqa: E402


def convolutions() -> list[tuple[int, ...]]:
    """Kernels' shapes in the file's order."""
    shapes: list[tuple[int, ...]] = [(32, 3, 3, 3)]
    for channels_in, channels_out, factor, kernel, _ in BLOCKS:
        inner = channels_in * factor
        shapes += [(inner, channels_in, 1, 1)] if factor > 1 else []
        shapes += [(inner, 1, kernel, kernel), (channels_out, inner, 1, 1)]
    return shapes


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file laid out like the wheel's, with a classifier behind."""
    torch.manual_seed(3)
    state = OrderedDict()
    for number, shape in enumerate(convolutions()):
        inputs = shape[1] * shape[2] * shape[3]
        state[f"{number}.weight"] = torch.randn(shape) * inputs**-0.5
        state[f"{number}.gain"] = torch.rand(shape[0]) + 0.5
        state[f"{number}.bias"] = torch.randn(shape[0]) * 0.2
        state[f"{number}.mean"] = torch.randn(shape[0]) * 0.2
        state[f"{number}.variance"] = torch.rand(shape[0]) + 0.3
        state[f"{number}.count"] = torch.tensor(7)
    state["fc.weight"] = torch.randn(10, 1280)
    path = tmp_path_factory.mktemp("weights") / "lite0.pth"
    torch.save(state, path)
    return path


def unfolded(image: torch.Tensor, file: Path, stop: int) -> torch.Tensor:
    """The first ``stop`` blocks written out with their normalisation."""
    functional = torch.nn.functional
    values = iter(torch.load(file).values())

    def layer(x: torch.Tensor, stride: int = 1, bend: bool = True) -> torch.Tensor:
        kernel, gain, bias, mean, variance, _ = (next(values) for _ in range(6))
        groups = x.shape[1] // kernel.shape[1]
        x = functional.conv2d(x, kernel, None, stride, kernel.shape[2] // 2, groups=groups)
        x = functional.batch_norm(x, mean, variance, gain, bias, training=False, eps=EPSILON)
        return functional.relu6(x) if bend else x

    mean, deviation = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    x = layer((image - mean.view(3, 1, 1)) / deviation.view(3, 1, 1), 2)
    for channels_in, channels_out, factor, _, stride in BLOCKS[:stop]:
        y = layer(x) if factor > 1 else x
        y = layer(layer(y, stride), bend=False)
        x = x + y if stride == 1 and channels_in == channels_out else y
    return x


def test_normalisation_is_folded_into_the_convolutions(file: Path) -> None:
    image = torch.rand(1, 3, 96, 128)
    backbone = Lite(file).eval()
    with torch.no_grad():
        f8, f16, f32 = backbone(image)
    assert [tuple(f.shape) for f in (f8, f16, f32)] == [(1, 40, 12, 16), (1, 112, 6, 8), (1, 96, 3, 4)]
    torch.testing.assert_close(f8, unfolded(image, file, STRIDE_8), rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(f16, unfolded(image, file, len(BLOCKS)), rtol=1e-3, atol=1e-3)


def test_what_is_frozen_and_what_moves_slowly(file: Path) -> None:
    network = Network(2, Lite(file))
    frozen = {name for name, p in network.named_parameters() if not p.requires_grad}
    assert frozen == {name for name, _ in network.named_parameters() if name.startswith("backbone.frozen")}
    assert len(frozen) == 2 * (1 + 2 + 3 * (FROZEN - 1))
    groups = _groups(network, 0.1)
    counted = {(g["pace"], g["weight_decay"]): sum(p.numel() for p in g["params"]) for g in groups}
    assert set(counted) == {(1.0, 0.1), (1.0, 0.0), (LEARNT_PACE, 0.1), (LEARNT_PACE, 0.0)}
    assert sum(counted.values()) == sum(p.numel() for p in network.parameters() if p.requires_grad)
    slow = sum(
        p.numel() for name, p in network.named_parameters() if name.startswith(("backbone.stage8", "backbone.stage16"))
    )
    assert counted[LEARNT_PACE, 0.1] + counted[LEARNT_PACE, 0.0] == slow
    assert not Network(2).learnt
