import pytest, sys
sys.path.insert(0,'.')
from tests.rig.true_motion import watch_machines
from tests.rig.benches import variant
from rig.cli.entry import status
from pathlib import Path
import json,os
def test(tmp_path, monkeypatch, capsys):
    for bench in sys.argv_benches:
      for loop in (None,"position","velocity","phases"):
        d=tmp_path/f"{bench}{loop}"; d.mkdir(); os.chdir(d)
        with pytest.MonkeyPatch.context() as m:
            found=watch_machines(m, loop)
            e=status(["commission",bench,"--yes","--angle","0","--out","out"])
        r=json.loads(Path("out/commission.json").read_text())
        last=r["sessions"][-1]
        with capsys.disabled():
            print("\n",bench,loop,e,found,last[-1]["name"],r["message"][:400])
            for s in last:
                if s["name"]=="signs": print([ (m["name"],m["value"]) for m in s["measured"]], s["verdict"], s["words"][:100])
        capsys.readouterr()
sys.argv_benches=["practical","practical_serial","practical_dbc"]
