"""Examples at the end of each command's help."""

EXAMPLES = {
    "robots": """
ik robots
ik robots --all --json""",
    "info": """
ik info hydrolek_7w
ik info brokk_hydrolek --list-tips""",
    "fk": """
ik fk hydrolek_7w
ik fk inspection_7dof --deg --q 20 0.22 20 0 20 0 20""",
    "solve": """
ik solve hydrolek_7w --xyz 1.0 0.1 0.2
ik solve hydrolek_7w --xyz 1.0 0.2 0.1 --rpy -1.6 0 -1.2 --json
ik solve hydrolek_7w --xyz 1.0 0.1 0.2 -s dls -p damping=0.05 --tolerance 1e-4
ik solve planar_2r --xyz 1 1 0 --all --deg
ik solve hydrolek_7w --xyz 1.0 0.1 0.2 --direction 0 0 -1
ik solve hydrolek_7w --xyz 1.0 0.1 0.2 --obstacle sphere:1,0.5,0.5,0.1
ik solve brokk_hydrolek --target left_tip:1.2,.4,1 --target right_tip:1,-.4,1
ik solve hydrolek_7w --targets poses.csv -o solutions.csv""",
    "path": """
ik path hydrolek_7w --poses cut.csv --free-turn z -o path.csv --plot path.png
ik path hydrolek_7w --poses cut.csv --retime --acceleration 1 -o motion.json""",
    "track": """
ik track hydrolek_7w --path circle
ik track hydrolek_7w --path eight --radius 0.08 --position-only --plot run.png
ik track hydrolek_7w --path line --length 0.2 --on-limit leave""",
    "reproduce": """
ik reproduce
ik reproduce chinyai -o report""",
    "solvers": """
ik solvers
ik solvers lm""",
    "bench": """
ik bench hydrolek_7w
ik bench planar_2r hydrolek_7w --solvers lm,dls -n 100 --tolerance 1e-4
ik bench hydrolek_7w --csv bench.csv --latex bench.tex""",
    "tune": """
ik tune hydrolek_7w pid --seconds 60 -o mine.toml
ik solve hydrolek_7w --xyz 1.0 0.1 0.2 --solver pid --preset mine.toml""",
    "workspace": """
ik workspace hydrolek_7w -n 1000 --plot map.png
ik workspace hydrolek_7w --solver lm --solver dls --csv targets.csv""",
    "dh": """
ik dh arm.toml -o arm.urdf""",
    "check": """
ik check hydrolek_7w
ik check arm.urdf --package-dir meshes""",
    "convert": """
ik convert arm.urdf.xacro -o arm.urdf""",
    "view": """
ik view hydrolek_7w
ik view hydrolek_7w --xyz 1.0 0.1 0.2 --html solve.html
ik view hydrolek_7w --follow
ik view hydrolek_7w --page hydrolek.html""",
    "panel": """
ik panel hydrolek_7w""",
    "doctor": """
ik doctor
ik doctor --prepare""",
}
