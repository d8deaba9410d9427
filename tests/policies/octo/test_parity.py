"""Our Octo against Flax's outputs of a tiny one with the same weights (``flax_reference.py``)."""

from importlib.util import find_spec

import numpy as np
import pytest
import torch

from envs.core.errors import PolicyError
from policies.octo.diffusion import cosine_betas
from policies.octo.flax_names import from_flax
from policies.octo.sizes import sizes_of
from policies.octo.transformer import looks_at
from tests.policies.octo import flax_numbers as numbers
from tests.policies.octo import tiny

needs_transformers = pytest.mark.skipif(
    find_spec("transformers") is None, reason="Octo needs the extra vla: uv pip install -e '.[vla]'"
)
pytestmark = [
    pytest.mark.filterwarnings(f"ignore::{kind}")
    for kind in ("UserWarning", "FutureWarning", "DeprecationWarning")
]


def images() -> dict[str, torch.Tensor]:
    found = {name: torch.from_numpy(numbers.images_of(name)).movedim(-1, 2) for name in numbers.CAMERAS}
    return {name: value.float() / 127.5 - 1.0 for name, value in found.items()}


def words(model) -> torch.Tensor:
    tokens = torch.tensor(numbers.WORDS)
    return model.words(tokens, (tokens != 0).long())


@needs_transformers
@pytest.mark.long
class TestParity:
    @torch.no_grad()
    def test_the_text_encoder(self):
        expected = torch.tensor(tiny.REFERENCE["words"])
        torch.testing.assert_close(words(tiny.network()), expected, rtol=1e-5, atol=5e-6)

    @torch.no_grad()
    @pytest.mark.parametrize("repeats", [False, True])
    @pytest.mark.parametrize("right", [False, True])
    @pytest.mark.parametrize("kind", ["all", "padded"])
    def test_the_readouts(self, repeats, right, kind):
        model = tiny.network(repeats=repeats, right=right)
        present = torch.tensor(numbers.PRESENT, dtype=torch.bool)
        found = model(images(), words(model), None if kind == "all" else present)
        expected = torch.tensor(tiny.REFERENCE["readouts"][f"{int(repeats)}{int(right)}{kind}"])
        torch.testing.assert_close(found, expected, rtol=1e-5, atol=5e-6)

    def test_the_attention_of_the_first_networks_differs(self):
        found = tiny.REFERENCE["readouts"]
        assert not np.allclose(found["11all"], found["10all"], atol=2e-5)

    @torch.no_grad()
    def test_the_diffusion_head(self):
        readout = torch.from_numpy(numbers.wave("readout", (numbers.BATCH, numbers.SIZES["width"])))
        noisy = torch.from_numpy(numbers.wave("noisy", (numbers.BATCH, 6)))
        found = tiny.network().head(readout, noisy, torch.tensor([[0], [3]]))
        torch.testing.assert_close(found, torch.tensor(tiny.REFERENCE["noise"]), rtol=1e-5, atol=5e-6)


def test_the_noise_schedule_is_the_cosine_of_its_authors():
    betas = cosine_betas(20)
    time = np.linspace(0, 20, 21) / 20
    kept = np.cos((time + 0.008) / 1.008 * np.pi / 2) ** 2
    np.testing.assert_allclose((1 - betas).cumprod(0)[:-1], (kept / kept[0])[1:-1], rtol=1e-9)
    assert betas[-1] == 0.999


def test_who_looks_at_whom():
    """Two words, two patches and a readout, twice: w w | p p r | p p r."""
    found = looks_at(2, [("observation", 2), ("readout", 1)], 2, right_groups=True).int().tolist()
    assert found == [
        [1, 1, 0, 0, 0, 0, 0, 0],
        [1, 1, 0, 0, 0, 0, 0, 0],
        [1, 1, 1, 1, 0, 0, 0, 0],
        [1, 1, 1, 1, 0, 0, 0, 0],
        [1, 1, 1, 1, 1, 0, 0, 0],
        [1, 1, 1, 1, 0, 1, 1, 0],
        [1, 1, 1, 1, 0, 1, 1, 0],
        [1, 1, 1, 1, 1, 1, 1, 1],
    ]


def test_the_first_networks_count_a_readout_among_the_patches():
    found = looks_at(1, [("observation", 2), ("readout", 1)], 1, right_groups=False)
    assert found[1:, 1:].all(), "patches look at it, which the rule forbids"


def test_a_parameter_of_another_network_is_one_sentence():
    with pytest.raises(PolicyError, match=r"'octo_transformer/pixel_tokens' is none of an Octo"):
        from_flax({"octo_transformer/pixel_tokens": torch.zeros(1)})


def test_sizes_are_those_of_the_published_configuration():
    content = tiny.config()
    content["model"]["heads"]["action"]["kwargs"] = {"readout_key": "readout_action", "action_horizon": 4}
    del content["text_config"]
    sizes = sizes_of(content)
    assert (sizes.action_dim, sizes.chunk_size, sizes.diffusion_steps, sizes.max_action) == (7, 4, 20, 5.0)
    assert sizes.text["num_layers"] == 12 and sizes.cameras == numbers.CAMERAS


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda model: model["heads"]["action"].update(name="MSEActionHead"), "has MSEActionHead"),
        (lambda model: model["heads"]["action"]["kwargs"].update(use_map=True), "has use_map=True"),
        (
            lambda model: model["task_tokenizers"].update(image={}),
            r"has task tokenizers \['image', 'language'\]",
        ),
        (
            lambda model: model.pop("readouts"),
            r"no configuration of a converted Octo \(KeyError\('readouts'\)",
        ),
    ],
)
def test_another_network_is_refused(change, said):
    content = tiny.config()
    change(content["model"])
    with pytest.raises(PolicyError, match=said):
        sizes_of(content)
