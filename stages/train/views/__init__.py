"""The photographs: loaded, framed, behind polarisers, and the losses on pixels."""
