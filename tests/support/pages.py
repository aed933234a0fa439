"""What the pages hold, read back."""

import base64
import gzip
import json


def unpacked(text):
    """The JSON that a page holds packed."""
    return json.loads(gzip.decompress(base64.b64decode(text)))
