"""A stand-in for the connection to a meshcat server, which is a process of its own."""

import numpy as np


class Wire:
    """What a meshcat server is sent, and what is drawn then: types and contents by path."""

    web_url = "nowhere"

    def __init__(self):
        self.objects, self.transforms, self.animations = {}, {}, []

    def send(self, command):
        sent = command.lower()
        path = sent["path"]
        match sent["type"]:
            case "set_object":
                self.objects[path] = sent["object"]
            case "set_transform":
                self.transforms[path] = np.array(sent["matrix"]).reshape(4, 4).T
            case "set_animation":
                self.animations.append(sent["animations"])
            case "delete":
                for kept in (self.objects, self.transforms):
                    for key in [key for key in kept if key == path or key.startswith(f"{path}/")]:
                        del kept[key]
