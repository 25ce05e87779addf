"""Encodings of files: the declared one, or that of the byte order mark; nothing but text is decoded."""

import pickle

import pytest
from elbow_arm import elbow
from second_fk import SecondFK

import ik_toolkit as ik
from ik_toolkit.errors import ModelError
from ik_toolkit.robot.convert import convert


@pytest.mark.parametrize(
    ("declared", "codec", "letter"),
    [
        ("ISO-8859-1", "latin-1", "ä"),
        ("windows-1252", "cp1252", "ä"),
        ("Shift_JIS", "shift_jis", "腕"),
        ("EUC-JP", "euc_jp", "腕"),
        ("GB18030", "gb18030", "腕"),
        ("KOI8-R", "koi8-r", "я"),
        ("UTF-16", "utf-16", "ä腕"),
        (None, "utf-16-le", "ä"),
        ("utf-8", "utf-8-sig", "ä"),
        ("UTF-16", "utf-8", "ä"),  # saved anew by an editor
        ("klingon", "utf-8", "ä"),
    ],
)
def test_declared_encodings(declared, codec, letter, tmp_path):
    head = f'<?xml version="1.0" encoding="{declared}"?>\n' if declared else '<?xml version="1.0"?>\n'
    file = tmp_path / "arm.urdf"
    file.write_bytes(elbow(head=head, name=f"joint_{letter}").encode(codec))
    robot = ik.Robot.load(file)
    assert robot.joint_names[1] == f"joint_{letter}"
    assert pickle.loads(pickle.dumps(robot)).joint_names == robot.joint_names
    SecondFK(robot.urdf)  # its text can be read again
    assert convert(file).text.encode("utf-8").decode("utf-8").count(letter) == 1


@pytest.mark.parametrize(
    "codec", ["zip", "hex", "rot13", "base64", "utf-7", "unicode_escape", "idna", "punycode", "../x"]
)
def test_only_encodings_of_text_are_decoded(codec, tmp_path):
    """Others are read as UTF-8, and refused where that fails."""
    file = tmp_path / "arm.urdf"
    head = f'<?xml version="1.0" encoding="{codec}"?>'
    file.write_text(elbow(head=head))
    assert ik.Robot.load(file).n == 2
    file.write_bytes(elbow(head=head, name="ä").encode("latin-1"))
    with pytest.raises(ModelError, match=f"is not UTF-8 text.*declares '{codec}', which is not read"):
        ik.Robot.load(file)


def test_bytes_that_are_not_what_is_declared(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_bytes(elbow(head='<?xml version="1.0" encoding="ascii"?>', name="ä").encode())
    with pytest.raises(ModelError, match=r"'arm.urdf' is not ascii text \(byte \d+\); save it as UTF-8"):
        ik.Robot.load(file)
    file.write_bytes(b'<?xml version="1.0" encoding="gbk"?><robot name="r">' + b"\x81\x30" * 9_000_000)
    with pytest.raises(ModelError, match=r"larger than 20 MB|is not gbk text"):
        ik.Robot.load(file)
