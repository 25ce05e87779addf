"""A robot with names that a page must treat as text only."""

import html
import html.parser

EVIL = (
    "<img src=x onerror=alert(1)>",
    "\"'><script>alert(2)</script>",
    "</script></title></textarea><b onload=alert(3)>",
    "$\\frac{1$ $x_1$ \\$",
    "/*@START@*/ @TITLE@ {0} %s",
    "a/../<object> & &lt;",
)


def arm(names=EVIL):
    """Text of a URDF with these names for its joints and in those of its links, each a box."""
    links, joints = "", ""
    for k in range(len(names) + 1):
        box = "<visual><geometry><box size='0.1 0.1 0.1'/></geometry></visual>"
        links += f"<link name={quoted(f'{k} {names[k % len(names)]}')}>{box}</link>"
    for k, name in enumerate(names):
        joints += (
            f"<joint name={quoted(name)} type='revolute'><parent link={quoted(f'{k} {name}')}/>"
            f"<child link={quoted(f'{k + 1} {names[(k + 1) % len(names)]}')}/><origin xyz='0.2 0.03 0.1'/>"
            f"<axis xyz='{k % 2} {1 - k % 2} 0.3'/><limit lower='-2' upper='2' effort='1' velocity='1'/></joint>"
        )
    return f"<robot name={quoted(' '.join(names))}>{links}{joints}</robot>"


def quoted(text):
    return '"' + html.escape(text, quote=True) + '"'


class Reader(html.parser.HTMLParser):
    """Tags, attributes and texts of a page, as a browser takes them."""

    def __init__(self, page):
        super().__init__(convert_charrefs=True)
        self.tags, self.handlers, self.text = [], [], ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.handlers += [(name, value) for name, value in attrs if name.startswith("on")]

    def handle_data(self, data):
        self.text += data
