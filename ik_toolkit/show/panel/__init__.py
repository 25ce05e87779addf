"""The panel in a browser (`ik panel`)."""
