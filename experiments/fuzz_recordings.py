"""Written stand-ins of recordings, two frames of each layout that is a folder of images."""

import io
import json

import cv2
import numpy as np

WIDTH, HEIGHT = 24, 16
CAMERA = {"fx": 20.0, "fy": 20.0, "cx": 11.5, "cy": 7.5}
POSE = np.array([[1.0, 0, 0, 0.5], [0, 1, 0, 0.25], [0, 0, 1, -1], [0, 0, 0, 1]])
K = np.array([[20.0, 0, 11.5, 0], [0, 20, 7.5, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
TUM = "# poses\n" + "".join(f"{n / 30:.6f} 0.5 0.25 -1 0 0 0 1\n" for n in range(3))

Files = dict[str, bytes]
"""Contents by path."""


def recordings() -> dict[str, Files]:
    """Files of each layout by its name."""
    return {**_listed(), **_described(), **_reconstructed()}


def png_of(image: np.ndarray) -> bytes:
    done, content = cv2.imencode(".png", image)
    assert done
    return content.tobytes()


def _jpg_of(image: np.ndarray) -> bytes:
    done, content = cv2.imencode(".jpg", image)
    assert done
    return content.tobytes()


def _npy_of(array: np.ndarray) -> bytes:
    content = io.BytesIO()
    np.save(content, array)
    return content.getvalue()


def text_of(matrix: np.ndarray) -> str:
    return "\n".join(" ".join(f"{x:.9g}" for x in row) for row in matrix) + "\n"


def _images() -> tuple[np.ndarray, np.ndarray]:
    """Colours, and depth in millimetres."""
    random = np.random.default_rng(0)
    colour = random.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    return colour, random.integers(1500, 2500, (HEIGHT, WIDTH), dtype=np.uint16)


def _listed() -> dict[str, Files]:
    """Layouts that list their files, or number them."""
    colour, depth = _images()
    png, d16, two = png_of(colour), png_of(depth), range(2)
    jpg, npy = _jpg_of(colour), _npy_of((depth / 1000).astype(np.float32))
    camera = json.dumps({**CAMERA, "depth_scale": 1000.0, "fps": 30.0}).encode()
    lens = json.dumps({**CAMERA, "distortion": [0.01, 0.0, 0.0, 0.0]}).encode()
    rows = b"".join(" ".join(f"{x:g}" for x in POSE.ravel()).encode() + b"\n" for _ in range(2))
    return {
        "tum": {
            "rgb.txt": b"# t f\n0.0 rgb/0.png\n0.0333 rgb/1.png\n",
            "depth.txt": b"0.0 depth/0.png\n0.0333 depth/1.png\n",
            "groundtruth.txt": TUM.encode(),
            "camera.json": camera,
            **{f"rgb/{n}.png": png for n in two},
            **{f"depth/{n}.png": d16 for n in two},
        },
        "folder, matrices": {
            "camera.json": camera,
            "poses.txt": rows,
            **{f"rgb/{n}.jpg": jpg for n in two},
            **{f"depth/{n}.png": d16 for n in two},
        },
        "folder, .npy and lens": {
            "camera.json": lens,
            "poses.txt": TUM.encode(),
            **{f"rgb/{n}.png": png for n in two},
            **{f"depth/{n}.npy": npy for n in two},
        },
        "replica": {
            "cam_params.json": json.dumps(
                {"camera": {**CAMERA, "w": WIDTH, "h": HEIGHT, "scale": 1000.0}}
            ).encode(),
            "traj.txt": rows,
            **{f"results/frame{n:06d}.jpg": jpg for n in two},
            **{f"results/depth{n:06d}.png": d16 for n in two},
        },
        "scannet": {
            "intrinsic/intrinsic_color.txt": text_of(K).encode(),
            "intrinsic/intrinsic_depth.txt": text_of(K * [[0.5], [0.5], [1], [1]]).encode(),
            **{f"pose/{n}.txt": text_of(POSE).encode() for n in two},
            **{f"color/{n}.jpg": jpg for n in two},
            **{f"depth/{n}.png": png_of(depth[::2, ::2]) for n in two},
        },
        "7scenes": {
            **{f"frame-{n:06d}.color.png": png_of(np.zeros((480, 640, 3), np.uint8)) for n in two},
            **{f"frame-{n:06d}.depth.png": png_of(np.full((480, 640), 2000, np.uint16)) for n in two},
            **{f"frame-{n:06d}.pose.txt": text_of(POSE).encode() for n in two},
        },
        "icl_nuim": {
            "associations.txt": b"0 depth/0.png 0 rgb/0.png\n1 depth/1.png 1 rgb/1.png\n",
            "livingRoom0.gt.freiburg": b"0 0.5 0.25 -1 0 0 0 1\n1 0.5 0.25 -1 0 0 0 1\n",
            "own.json": camera,
            **{f"rgb/{n}.png": png for n in two},
            **{f"depth/{n}.png": d16 for n in two},
        },
    }


def _described() -> dict[str, Files]:
    """Layouts that a file describes."""
    colour, depth = _images()
    png, d16, two = png_of(colour), png_of(depth), range(2)
    return {
        "open3d": {
            "intrinsic.json": json.dumps(
                {"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": K[:3, :3].T.ravel().tolist()}
            ).encode(),
            "trajectory.log": "".join(f"{n} {n} {n + 1}\n{text_of(POSE)}" for n in two).encode(),
            **{f"color/{n:05d}.png": png for n in two},
            **{f"depth/{n:05d}.png": d16 for n in two},
        },
        "euroc": {
            "mav0/cam0/data.csv": b"#ns,file\n1000000000,0.png\n1033000000,1.png\n",
            "mav0/depth0/data.csv": b"#ns,file\n1000000000,0.png\n1033000000,1.png\n",
            "mav0/cam0/sensor.yaml": (
                f"camera_model: pinhole\nresolution: [{WIDTH}, {HEIGHT}]\n"
                "intrinsics: [20.0, 20.0, 11.5, 7.5]\n"
                "T_BS:\n  data: [1, 0, 0, 0.1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
            ).encode(),
            "mav0/state_groundtruth_estimate0/data.csv": (
                b"#t,x,y,z,w,x,y,z\n1000000000,0,0,1,1,0,0,0\n1050000000,0,0,1,1,0,0,0\n"
            ),
            **{f"mav0/cam0/data/{n}.png": png for n in two},
            **{f"mav0/depth0/data/{n}.png": d16 for n in two},
        },
        "scannetpp": {
            "pose_intrinsic_imu.json": json.dumps(
                {
                    f"frame_{n:06d}": {
                        "timestamp": n / 30,
                        "pose": POSE.tolist(),
                        "intrinsic": K[:3, :3].tolist(),
                    }
                    for n in two
                }
            ).encode(),
            **{f"rgb/frame_{n:06d}.png": png for n in two},
            **{f"depth/frame_{n:06d}.png": d16 for n in two},
        },
    }


def _reconstructed() -> dict[str, Files]:
    """Layouts of reconstructions from photographs, with depth beside them."""
    colour, depth = _images()
    png, d16, two = png_of(colour), png_of(depth), range(2)
    metres = (depth / 1000).astype(np.float32)
    return {
        "nerfstudio": {
            "transforms.json": json.dumps(
                {
                    **{"w": WIDTH, "h": HEIGHT, "fl_x": 20.0, "fl_y": 20.0, "cx": 12, "cy": 8, "k1": 0.01},
                    "frames": [
                        {
                            "file_path": f"images/{n}.png",
                            "depth_file_path": f"depth/{n}.png",
                            "transform_matrix": POSE.tolist(),
                        }
                        for n in two
                    ],
                }
            ).encode(),
            **{f"images/{n}.png": png for n in two},
            **{f"depth/{n}.png": d16 for n in two},
        },
        "colmap": {
            "sparse/0/cameras.txt": f"1 PINHOLE {WIDTH} {HEIGHT} 20 20 12 8\n".encode(),
            "sparse/0/images.txt": b"1 1 0 0 0 0.5 0 1 1 0.png\n\n2 1 0 0 0 0.5 0 1 1 1.png\n\n",
            **{f"images/{n}.png": png for n in two},
            "stereo/depth_maps/0.png.geometric.bin": f"{WIDTH}&{HEIGHT}&1&".encode() + metres.tobytes(),
            "depth/1.png": d16,
        },
    }
