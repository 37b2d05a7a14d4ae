"""One moment of a run, put on the page and into the scene."""

from dataclasses import dataclass

import numpy as np
import viser

from sfgs_jax.geometry import Frame, Trajectory, se3
from sfgs_jax.slam import Run, SlamState
from sfgs_jax.viewer._live_comparison import compare
from sfgs_jax.viewer._live_page import BEHIND, FREE, THROUGH, LivePage
from sfgs_jax.viewer._live_plots import History
from sfgs_jax.viewer._live_scene import LiveScene
from sfgs_jax.viewer._live_truth import TruthBeside, position_bounds, truth_beside
from sfgs_jax.viewer._viewpoints import look_from_behind, look_through


@dataclass(frozen=True)
class Snapshot:
    """A run after a frame or a final map step. Nothing in it changes any more.

    Attributes:
        state: of the run.
        frame: the newest frame that could be decoded, if there is one.
        headline: what the run is doing.
        share: of the work that is done, in [0, 1].
        steps: frames and final map steps so far.
        urgent: whether it is to be shown at once, because the run waits.
        ended: whether the run has ended.
    """

    state: SlamState
    frame: Frame | None
    headline: str
    share: float
    steps: int
    urgent: bool
    ended: bool


class LiveDisplay:
    """Brings page and scene up to date.

    Args:
        server: the viser server.
        scene: the scene.
        page: the page.
        history: of the run; the PSNR of each update is added.
        truth: ground truth, if there is any.
        max_gaussians: Gaussians to draw before the run has ended.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        scene: LiveScene,
        page: LivePage,
        history: History,
        *,
        truth: Trajectory | None,
        max_gaussians: int,
    ) -> None:
        self._server, self._scene, self._page, self._history = server, scene, page, history
        self._truth, self._max_gaussians = truth, max_gaussians

    def move(self, snapshot: Snapshot) -> None:
        """Say what the run is doing, and put the camera in its place. This takes little time.

        Args:
            snapshot: the run now.
        """
        if snapshot.ended:
            self._page.end(snapshot.headline)
        else:
            self._page.tell(snapshot.headline, snapshot.share)
        if not len(snapshot.state.log.timestamps):
            return
        camera = snapshot.state.camera
        pose = se3.matrices_of(np.asarray(snapshot.state.T_world_cam.wxyz_xyz)[None])[0]
        self._scene.show_camera(camera, pose)
        viewpoint = self._page.viewpoint
        self._scene.show_marks(viewpoint != THROUGH)
        if viewpoint == FREE:
            return
        for client in self._server.get_clients().values():
            if viewpoint == BEHIND:
                look_from_behind(client, pose)
            else:
                look_through(client, pose, camera)

    def show(self, snapshot: Snapshot) -> None:
        """Send everything that has changed.

        Args:
            snapshot: the run now.
        """
        state = snapshot.state
        trajectory, covariances = state.trajectory, state.covariances
        if not len(trajectory):
            return
        # Nothing tells where other maps lie to the truth of this one.
        known = Run(state).maps[0].rows
        beside = None if self._truth is None else truth_beside(trajectory[known], self._truth)
        self._scene.show(
            state,
            trajectory,
            covariances,
            None if beside is None else beside.path,
            most_gaussians=None if snapshot.ended else self._max_gaussians,
        )
        if snapshot.frame is not None:
            compared = compare(state, snapshot.frame)
            self._page.picture.image = compared.picture
            self._history.steps.append(snapshot.steps)
            self._history.psnr.append(compared.psnr)
        bounds = position_bounds(covariances)
        rows = np.zeros(0, int) if beside is None else known[beside.rows]
        errors = np.zeros(0) if beside is None else beside.errors_m
        self._page.plots.show(self._history, state.log.numbers[rows], errors, bounds[rows])
        self._page.tell_facts(self._facts(state, beside, float(bounds[-1])))

    def _facts(self, state: SlamState, beside: TruthBeside | None, bound_m: float) -> dict[str, str]:
        rotation = np.degrees(3 * np.sqrt(np.trace(state.covariances[-1, 3:, 3:])))
        facts = {
            "Gaussians": f"{state.mapping.num_gaussians:,}",
            "Keyframes": f"{len(state.graph.keyframes)}",
            "Loops": f"{len(state.graph.loops)}",
            "Lost frames": f"{state.num_lost}",
            "3 sigma of the pose": f"{1000 * bound_m:.1f} mm, {rotation:.2f}°",
        }
        if self._history.psnr:
            facts["PSNR"] = f"{self._history.psnr[-1]:.1f} dB"
        if beside is not None:
            facts["ATE"] = f"{100 * beside.rmse_m:.2f} cm"
        recent = self._history.frame_ms[-30:]
        if recent:
            facts["Time of a frame"] = f"{np.median(recent):.0f} ms"
        return facts
