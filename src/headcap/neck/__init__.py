"""The neck: the larynx that slides under the skin (paper, section 3.1)."""

from headcap.neck.chart import Distortion, NeckChart, build_chart
from headcap.neck.larynx import LarynxMap, LarynxSettings, larynx_map

__all__ = ["Distortion", "LarynxMap", "LarynxSettings", "NeckChart", "build_chart", "larynx_map"]
