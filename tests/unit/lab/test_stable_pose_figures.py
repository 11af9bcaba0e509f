"""The figures of stable poses are drawn alike each time, and small enough to be kept."""

from palmd.lab import stable_pose_figures


def test_the_same_figures_each_time(tmp_path):
    folders = tmp_path / "one", tmp_path / "two"
    drawn = []
    for folder in folders:
        folder.mkdir()
        drawn.append([path.read_bytes() for path in stable_pose_figures.save(folder)])
    assert drawn[0] == drawn[1]
    assert all(1e4 < len(each) < 4e5 for each in drawn[0])
