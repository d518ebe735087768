import optlink,time,sys,math
from optlink.dynamics import drive as D
import numpy as np
p=optlink.load("/tmp/hostile/tors.toml",{"drive.torque":"30 N*m"})
t0=time.time()
class Stop(Exception): pass
st=[]
orig=D._event
def ev(curve,start,end,*a):
    st.append((end,end-start,math.degrees(curve(end)[0])%360)); 
    if time.time()-t0>40: raise KeyboardInterrupt
    return orig(curve,start,end,*a)
D._event=ev
s=optlink.simulate(p,duration=1.0)
print(s.run.ending,time.time()-t0,s.figures)
s=np.array(st); print(len(s), np.percentile(s[:,1],[0,10,50,90,100])); print(s[-30:]); print((s[:,1]<1e-10).sum())
h=np.histogram(s[:,2],bins=36,range=(0,360))[0]; print(h)
