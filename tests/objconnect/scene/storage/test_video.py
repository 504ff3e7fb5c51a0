"""Videos: frames with their times, pictures turned as they are shown, and broken files."""

from __future__ import annotations

import logging
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from objconnect.scene.errors import InputError
from objconnect.scene.storage.video import decode_frames, read_video, write_video

av = pytest.importorskip("av")


def pictures(count: int, height: int = 48, width: int = 64) -> list[np.ndarray]:
    """Grey pictures that become brighter by 8 each, with a red corner at the top left."""
    made = [np.full((height, width, 3), 8 * k, np.uint8) for k in range(count)]
    for picture in made:
        picture[:16, :16] = (255, 0, 0)
    return made


def noise(count: int) -> list[np.ndarray]:
    return list(np.random.default_rng(0).integers(0, 256, (count, 48, 64, 3), dtype=np.uint8))


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    path = tmp_path / "FLIGHT.MP4"
    write_video(path, pictures(20), 10.0)
    return path


def grey(image: np.ndarray) -> int:
    """The number of the picture that an image shows."""
    return round(float(image[30:, 30:].mean()) / 8)


def test_frames_come_in_order_with_their_times(flight: Path) -> None:
    frames = list(decode_frames(flight))

    assert [frame.index for frame in frames] == list(range(20))
    np.testing.assert_allclose([frame.seconds for frame in frames], np.arange(20) / 10, atol=1e-6)
    assert [grey(frame.image) for frame in frames] == list(range(20))
    assert frames[0].image.dtype == np.uint8 and frames[0].image.shape == (48, 64, 3)
    assert frames[0].image[4, 4, 0] > 200 > 100 > frames[0].image[4, 4, 1]


@pytest.mark.parametrize(
    ("rate", "expected"),
    [
        (10.0, list(range(20))),
        (5.0, list(range(0, 20, 2))),
        (2.0, [0, 5, 10, 15]),
        # Nearest to 0, 1/3, 2/3, ... s.
        (3.0, [0, 3, 7, 10, 13, 17]),
        (0.5, [0]),
        (1000.0, list(range(20))),
    ],
)
def test_frames_at_a_rate(flight: Path, rate: float, expected: list[int]) -> None:
    assert [frame.index for frame in decode_frames(flight, rate)] == expected


def test_what_a_video_says(flight: Path) -> None:
    video = read_video(flight)
    assert (video.width, video.height, video.rate_hz, video.duration_s) == (64, 48, 10.0, 2.0)


@pytest.mark.parametrize(("degrees", "corner"), [(90, (-5, 4)), (180, (-5, -5)), (-90, (4, -5))])
def test_frames_are_turned_as_they_are_shown(
    tmp_path: Path, degrees: int, corner: tuple[int, int]
) -> None:
    """By FFmpeg's documentation its angle turns the frame counter-clockwise."""
    path = tmp_path / "turned.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=5)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.set_display_rotation(degrees)
        for picture in pictures(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())

    frame = next(decode_frames(path))
    assert frame.image.shape == ((64, 48, 3) if abs(degrees) == 90 else (48, 64, 3))
    assert frame.image[corner][0] > 200
    assert (read_video(path).height, read_video(path).width) == frame.image.shape[:2]


def test_a_slant_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "slant.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=5)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.set_display_rotation(30)
        container.mux(stream.encode(av.VideoFrame.from_ndarray(pictures(1)[0], format="rgb24")))
        container.mux(stream.encode())
    with pytest.raises(InputError, match="rotated by"):
        read_video(path)


@pytest.mark.parametrize(
    "content", [b"", b"\x00" * 4096, b"1\n00:00:00,000 --> 00:00:01,000\nhi\n"]
)
def test_other_files_are_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "FLIGHT.MP4"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"FLIGHT\.MP4") as refused:
        read_video(path)
    assert "\n" not in str(refused.value)


def test_an_unknown_codec_is_refused_in_one_line(flight: Path) -> None:
    whole = flight.read_bytes()
    assert whole.count(b"avc1") == 2
    flight.write_bytes(whole.replace(b"avc1", b"zzzz"))
    with pytest.raises(InputError, match="its codec is unknown"):
        read_video(flight)


def test_a_video_without_its_index_is_refused_in_one_line(flight: Path) -> None:
    """The index of an MP4 file comes last: a card that was pulled out leaves none."""
    flight.write_bytes(flight.read_bytes()[:900])
    with pytest.raises(InputError, match="cannot be read as a video"):
        list(decode_frames(flight))


def test_frames_before_a_cut_are_kept(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "cut.mp4"
    with av.open(str(path), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("mpeg4", rate=2)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for picture in noise(20):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    data = path.read_bytes()
    path.write_bytes(data[: 2 * len(data) // 3])

    with caplog.at_level(logging.WARNING):
        frames = list(decode_frames(path))
    assert 8 <= len(frames) <= 15
    assert [frame.index for frame in frames] == list(range(len(frames)))
    assert any(
        "is used up to there" in line or "these frames are used" in line for line in caplog.messages
    )


def test_odd_and_changing_sizes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="odd side"):
        write_video(tmp_path / "a.mp4", pictures(1, height=47), 2.0)
    with pytest.raises(InputError, match="several sizes"):
        write_video(tmp_path / "b.mp4", [*pictures(1), *pictures(1, height=64)], 2.0)


def test_a_folder_is_no_video(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read video"):
        read_video(tmp_path)


def write_streams(
    path: Path, *streams: tuple[str, int, int, int], covers: int = 0, default: int | None = None
) -> Path:
    """A file of several streams: codec, number of frames, width and grey level."""
    with av.open(str(path), "w") as container:
        made = []
        for row, (codec, _, width, _) in enumerate(streams):
            stream = container.add_stream(codec, rate=10)
            stream.width, stream.height = width, 48
            stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            if row < covers:
                stream.disposition = av.stream.Disposition.attached_pic
            elif default is not None:
                flag = av.stream.Disposition.default
                stream.disposition = flag if row == default else av.stream.Disposition(0)
            made.append(stream)
        for stream, (_, count, width, level) in zip(made, streams, strict=True):
            for k in range(count):
                picture = np.full((48, width, 3), level, np.uint8)
                frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
                frame.pts = k
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
    return path


def levels(path: Path) -> tuple[int, int]:
    """Number of frames and grey level of a video."""
    frames = list(decode_frames(path))
    return len(frames), round(float(frames[0].image.mean()) / 10) * 10


COVER, FILM, PREVIEW = ("mjpeg", 1, 32, 200), ("mpeg4", 20, 64, 100), ("mpeg4", 20, 32, 50)


@pytest.mark.parametrize(
    ("streams", "covers"),
    [
        ([COVER, FILM], 0),
        ([COVER, FILM], 1),
        ([FILM, COVER], 0),
        ([COVER, COVER, FILM], 2),
        ([("mpeg4", 1, 320, 200), FILM], 0),
        ([("mjpeg", 20, 64, 100), COVER], 0),
        ([PREVIEW, FILM], 0),
        ([FILM, PREVIEW], 0),
    ],
)
@pytest.mark.parametrize("ending", ["mp4", "mov"])
def test_the_video_stream_and_not_the_cover(
    tmp_path: Path, streams: list[tuple[str, int, int, int]], covers: int, ending: str
) -> None:
    path = write_streams(tmp_path / f"a.{ending}", *streams, covers=covers)
    assert levels(path) == (20, 100)
    assert read_video(path).width == 64


def test_of_several_streams_the_one_that_players_show(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_streams(tmp_path / "a.mkv", ("mpeg4", 20, 64, 50), FILM, default=1)
    assert levels(path) == (20, 100)
    (line,) = [line for line in caplog.messages if "2 video streams" in line]
    assert "stream 1 (64 x 48) is used, stream 0 ignored" in line


def test_pictures_alone_are_no_video(tmp_path: Path) -> None:
    for path in (
        write_streams(tmp_path / "a.mp4", COVER),
        write_streams(tmp_path / "b.jpg", COVER),
    ):
        with pytest.raises(InputError, match="only still pictures and no video stream"):
            read_video(path)


def test_streams_that_are_not_read_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.ts"
    with av.open(str(path), "w", format="mpegts") as container:
        stream = container.add_stream("mpeg2video", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        data = container.add_data_stream("klv")
        for k, picture in enumerate(noise(5)):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            packet = av.Packet(b"\x06\x0e\x2b\x34")
            packet.stream, packet.pts, packet.dts = data, 3600 * k, 3600 * k
            packet.time_base = Fraction(1, 90_000)
            container.mux(packet)
        container.mux(stream.encode())
    assert read_video(path).unread == ("klv",)


def test_pixels_that_are_not_square(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)
        for picture in noise(3):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    assert read_video(path).pixel_aspect == pytest.approx(4 / 3)
