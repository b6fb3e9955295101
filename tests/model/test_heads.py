"""Fresh heads: what they start with."""

import torch

from gsynopsis.model.heads import head_outputs, init_networks


def test_opacity_starts_elsewhere_and_nothing_else() -> None:
    plain = init_networks(12, 10, 48, None, torch.Generator().manual_seed(0))
    other = init_networks(12, 10, 48, None, torch.Generator().manual_seed(0), (0.3, 2.0))
    changed = {name for name in plain if not torch.equal(plain[name], other[name])}
    assert changed == {"opacity_w2", "opacity_b2"}
    features, view = torch.zeros(5, 12), torch.randn(5, 4)
    before, after = (head_outputs(n, features, view)[0] for n in (plain, other))
    torch.testing.assert_close(after, 2 * before + 0.3)


def test_most_slots_show_at_first_with_a_bias() -> None:
    generator = torch.Generator().manual_seed(0)
    view = torch.nn.functional.normalize(torch.randn(50, 3, generator=generator), dim=1)
    view = torch.cat([view, torch.full((50, 1), 0.5)], dim=1)

    def shown(opacity: tuple[float, float]) -> float:
        shares: list[float] = []
        for _ in range(50):
            networks = init_networks(12, 10, 48, None, generator, opacity)
            outputs = head_outputs(networks, torch.zeros(50, 12), view)[0]
            shares.append(float((outputs > 0).float().mean()))
        return sum(shares) / len(shares)

    assert 0.4 < shown((0.0, 1.0)) < 0.6
    assert shown((0.3, 2.0)) > 0.7
