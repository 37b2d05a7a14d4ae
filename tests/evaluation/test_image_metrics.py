import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.evaluation import PROTOCOLS, frames_of, psnr, psnr_by_protocol, ssim_by_protocol
from sfgs_jax.splatting import ssim

_H, _W = 20, 24

ALL = np.ones((_H, _W), bool)


@pytest.fixture
def rgb(rng):
    return rng.uniform(0.2, 0.8, (_H, _W, 3)).astype(np.float32)


@pytest.fixture
def depth():
    """Missing in the left quarter."""
    depth = np.full((_H, _W), 2.0, np.float32)
    depth[:, : _W // 4] = 0
    return depth


def test_psnr_of_known_errors():
    black = jnp.zeros((4, 5, 3))
    assert float(psnr(black, black + 0.1)) == pytest.approx(20)
    assert float(psnr(black.at[0, 0, 0].set(1), black)) == pytest.approx(10 * np.log10(60), rel=1e-5)


def test_equal_images_have_the_largest_figures(rgb, depth):
    for protocol in PROTOCOLS:
        assert float(psnr_by_protocol(rgb, rgb, depth, ALL)[protocol]) == pytest.approx(100)
        assert float(ssim_by_protocol(rgb, rgb, depth, ALL)[protocol]) == pytest.approx(1)


def test_pixels_without_depth_agree_and_count_in_masked_protocols(rgb, depth):
    """An error of 0.1 everywhere: three quarters of it are left where a quarter is set to zero."""
    figures = psnr_by_protocol(rgb + np.float32(0.1), rgb, depth, ALL)
    assert float(figures["all"]) == pytest.approx(20, abs=1e-4)
    assert float(figures["held_out"]) == pytest.approx(20, abs=1e-4)
    assert float(figures["gs_icp"]) == pytest.approx(20 - 10 * np.log10(0.75), abs=1e-4)
    assert float(figures["splatam"]) == pytest.approx(20 - 10 * np.log10(0.75), abs=1e-4)


def test_errors_where_depth_is_missing_count_only_in_unmasked_protocols(rgb, depth):
    rendered = np.where(depth[..., None] > 0, rgb, np.float32(0))
    quality, structure = (
        psnr_by_protocol(rendered, rgb, depth, ALL),
        ssim_by_protocol(rendered, rgb, depth, ALL),
    )
    for protocol in ("all", "held_out"):
        assert float(quality[protocol]) < 20
        assert float(structure[protocol]) < 0.9
    for protocol in ("gs_icp", "splatam"):
        assert float(quality[protocol]) == pytest.approx(100)
        assert float(structure[protocol]) == pytest.approx(1)


def test_splatam_averages_over_channels_in_decibels(rgb):
    """Errors of 0.1 in red and 0.01 in green and blue are 20, 40 and 40 dB."""
    error = np.asarray([0.1, 0.01, 0.01], np.float32)
    figures = psnr_by_protocol(rgb + error, rgb, np.ones((_H, _W), np.float32), ALL)
    assert float(figures["splatam"]) == pytest.approx((20 + 40 + 40) / 3, abs=1e-3)
    assert float(figures["gs_icp"]) == pytest.approx(-10 * np.log10((0.01 + 2e-4) / 3), abs=1e-3)
    assert float(figures["all"]) == pytest.approx(float(figures["gs_icp"]), abs=1e-3)


def test_pixels_without_depth_do_not_count_in_depth(rgb, depth):
    error = np.where(depth[..., None] > 0, np.float32(0.1), np.float32(0.5))
    assert float(psnr_by_protocol(rgb * 0, rgb * 0 + error, depth, ALL)["depth"]) == pytest.approx(
        20, abs=1e-4
    )


def test_exposure_is_fitted_to_each_channel(rgb, depth):
    """A gain and an offset of each channel are taken out, what else differs stays."""
    gain, offset = np.asarray([0.8, 1.1, 0.9], np.float32), np.asarray([0.05, -0.02, 0.03], np.float32)
    other = (rgb - offset) / gain
    assert float(psnr_by_protocol(other, rgb, depth, ALL)["gs_icp"]) < 30
    assert float(psnr_by_protocol(other, rgb, depth, ALL)["gs_icp_exposure"]) > 60
    assert float(ssim_by_protocol(other, rgb, depth, ALL)["gs_icp_exposure"]) > 0.999
    stripes = np.where(np.arange(_W)[:, None] % 2, np.float32(0.1), np.float32(-0.1))
    left = float(
        psnr_by_protocol(np.full_like(rgb, 0.5), 0.5 + stripes + 0 * rgb, depth, ALL)["gs_icp_exposure"]
    )
    assert left == pytest.approx(20 - 10 * np.log10(0.75), abs=1e-3)


def test_pixels_beyond_the_lens_count_nowhere(rgb, depth):
    valid = ALL.copy()
    valid[:3] = False
    broken = np.where(valid[..., None], rgb, np.float32(0))
    for protocol in PROTOCOLS:
        assert float(psnr_by_protocol(rgb, broken, depth, valid)[protocol]) == pytest.approx(100)
        assert float(ssim_by_protocol(rgb, broken, depth, valid)[protocol]) == pytest.approx(1)


def test_rendered_colours_are_clipped(depth):
    white = np.ones((_H, _W, 3), np.float32)
    assert float(psnr_by_protocol(3 * white, white, depth, ALL)["all"]) == pytest.approx(100)
    assert float(ssim_by_protocol(3 * white, white, depth, ALL)["all"]) == pytest.approx(1)


def test_ssim_is_of_the_images_with_zeros(rgb, depth, rng):
    noisy = np.clip(rgb + 0.1 * rng.normal(size=rgb.shape), 0, 1).astype(np.float32)
    figures = ssim_by_protocol(noisy, rgb, depth, ALL)
    mask = (depth > 0)[..., None].astype(np.float32)
    for protocol, weight in (("all", np.float32(1)), ("gs_icp", mask)):
        expected = float(ssim(jnp.asarray(noisy * weight), jnp.asarray(rgb * weight)))
        assert float(figures[protocol]) == pytest.approx(expected, abs=1e-5)


def test_frames_of_the_protocols():
    keyframes = np.asarray([0, 3, 11])
    members = {name: np.flatnonzero(frames_of(name, 12, keyframes)).tolist() for name in PROTOCOLS}
    for name in ("all", "depth", "gs_icp", "gs_icp_exposure", "gs_icp_raw"):
        assert members[name] == list(range(12))
    assert members["splatam"] == [0, 4, 9]
    assert members["views"] == [0, 3, 11]
    assert members["held_out"] == [4]


def test_held_out_frames_are_every_eighth_unless_a_run_used_them():
    members = np.flatnonzero(frames_of("held_out", 30, np.asarray([12, 13])))
    assert members.tolist() == [4, 20, 28]


def test_only_raw_shows_the_maps_own_colours(rgb, depth):
    own = rgb + np.float32(0.1)
    figures = psnr_by_protocol(rgb, rgb, depth, ALL, own)
    assert float(figures["gs_icp_raw"]) == pytest.approx(20 - 10 * np.log10(0.75), abs=1e-4)
    assert min(float(figures[name]) for name in PROTOCOLS if name != "gs_icp_raw") == pytest.approx(100)
    assert float(ssim_by_protocol(rgb, rgb, depth, ALL, own)["gs_icp_raw"]) < 0.999
