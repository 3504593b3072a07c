"""A map made from a resting throat alone predicts where a body that slides beneath the skin lifts it (paper, section 3.1)."""

import numpy as np
import pytest

from headcap.heads import base_head, procedural_model
from headcap.neck import build_chart, larynx_map
from headcap.synthetic.anatomy import find_places
from headcap.synthetic.identity import bare_throat
from headcap.synthetic.larynx import build_larynx

SLIDES_M = (-0.012, -0.006, 0.006, 0.012, 0.018)


@pytest.fixture(scope="module")
def throat():
    """The model, a bare throat, and what a larynx 6 mm high does to it at any slide: a body in space, no map."""
    model, head = procedural_model(3, 3, np.float64), base_head()
    places = find_places(head)
    bare = bare_throat(head.vertices, head.triangles, places)
    body = build_larynx(bare, ~head.regions["mouth_interior"], places, 0.006)

    def lift(slide_m: float) -> np.ndarray:
        offset = np.zeros_like(bare)
        offset[body.vertices] = body.lift(slide_m, 1.0)
        return offset

    return model, bare, lift


def errors_mm(larynx, lift) -> list[float]:
    """Rms over the region of the predicted lift at each slide."""
    out = []
    for slide in SLIDES_M:
        error = larynx.offset(slide).values - lift(slide)[larynx.vertices]
        out.append(1e3 * np.sqrt((error**2).sum(axis=1).mean()))
    return out


def made_at_rest(model, neutral, rest):
    """Equation 9 for the direction, 10 for the weights, on a chart of the given throat."""
    larynx = larynx_map(model, build_chart(model, neutral), rest[model.regions["larynx"]].sum(axis=0))
    return larynx.fitted(rest[larynx.vertices] @ larynx.direction)


def test_the_region_holds_the_whole_larynx(throat):
    model, _, lift = throat
    for slide in (0.0, *SLIDES_M):
        assert np.abs(lift(slide)[~model.regions["larynx"]]).max() < 0.05e-3


def test_slides_are_predicted_from_rest(throat):
    model, bare, lift = throat
    errors = errors_mm(made_at_rest(model, bare, lift(0.0)), lift)
    # the lift itself is 1 mm rms over the region and 6 mm at its top
    assert max(errors) < 0.12
    # laying out the bare throat, T_0, is better than laying out the throat with its bump
    assert np.mean(errors) < np.mean(errors_mm(made_at_rest(model, bare + lift(0.0), lift(0.0)), lift))


def test_the_slide_is_found_again(throat):
    """Equation 12 on exact data: the best correlation is at the body's slide, to the chart's stretch of a few per cent."""
    model, bare, lift = throat
    larynx = made_at_rest(model, bare, lift(0.0))
    tried = np.arange(-0.03, 0.03, 0.0002)
    weights = larynx.weights_at(tried)[0]
    for slide in SLIDES_M:
        seen = lift(slide)[larynx.vertices] @ larynx.direction
        match = (weights @ seen) / (np.linalg.norm(weights, axis=1) * np.linalg.norm(seen))
        assert match.max() > 0.998
        assert tried[match.argmax()] == pytest.approx(slide, abs=0.06 * abs(slide) + 0.0002)
