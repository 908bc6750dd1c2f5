"""Videos as phones and other programs write them."""

from fractions import Fraction

import av


def write_recording(path, pictures, codec="libx264", form="yuv420p", options=None, rate=25,
    times=None, tick=1000, aspect=1):  # fmt: skip
    """Write pictures (H, W, 3) at an even rate, or at times in parts of a second; return the path.

    There are ``tick`` parts in a second.
    """
    pictures, unit = list(pictures), Fraction(1, tick)
    with av.open(str(path), "w") as file:
        stream = file.add_stream(codec, rate=rate)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.options = form, options or {}
        if times is not None:
            stream.time_base = stream.codec_context.time_base = unit
        if aspect != 1:
            stream.codec_context.sample_aspect_ratio = Fraction(aspect)
        for k, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, "rgb24")
            if times is not None:
                frame.pts, frame.time_base = times[k], unit
            file.mux(stream.encode(frame))
        file.mux(stream.encode())
    return path
