import cv2
import numpy as np

from flflab.optics.distortion import BrownDistortion


def test_points_move_as_opencv_moves_them() -> None:
    points = np.random.default_rng(7).uniform(-1, 1, (200, 2))
    k1, k2, k3, p1, p2 = 0.11, -0.07, 0.02, 0.004, -0.006
    ahead = np.concatenate([points, np.ones((200, 1))], axis=1)
    # OpenCV's p1 goes with r^2 + 2 y^2, its p2 with r^2 + 2 x^2
    expected, _ = cv2.projectPoints(
        ahead, np.zeros(3), np.zeros(3), np.eye(3), np.array([k1, k2, p1, p2, k3])
    )
    found = BrownDistortion((k1, k2, k3), (p2, p1)).displace(points)
    assert np.abs(found - expected[:, 0]).max() < 1e-12


def test_the_axis_stays_where_it_is() -> None:
    assert not BrownDistortion((1.0, 2.0, 3.0), (4.0, 5.0)).displace(np.zeros((1, 2))).any()
