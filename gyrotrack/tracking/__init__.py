"""From frames to angles: scene, markers, matching, association, uncertainty."""
