"""A page holds what it is given, and nothing from elsewhere."""

import numpy as np

from gva_mi.study.page import (
    Headline,
    Section,
    Table,
    animation,
    number,
    picture,
    write_page,
)


def test_a_page_is_one_file_with_its_pictures(tmp_path):
    image = np.zeros((4, 6, 3), np.uint8)
    section = Section(
        "Section <1>",
        "A & B",
        [picture("grey", image + 128), animation("moving", [image] * 2)],
        tables=[Table(("name", "value"), [("x < y", number(1.25, 1)), ("z", number(None, 3))])],
    )
    write_page(
        tmp_path / "page.html",
        title="Title",
        subtitle="Subtitle",
        headlines=[Headline("3 mm", "error")],
        sections=[section],
        settings={"seed": 7},
    )
    page = (tmp_path / "page.html").read_text()
    for text in ("Section &lt;1&gt;", "A &amp; B", "x &lt; y", "1.2", "–", "3 mm"):
        assert text in page, text
    assert "&#34;seed&#34;: 7" in page and page.count("data:image/webp;base64,") == 2
    assert "http" not in page and [p.name for p in tmp_path.iterdir()] == ["page.html"]
