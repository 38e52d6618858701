import numpy as np
from math import lgamma
from kinpole_ros.derivatives import _models as M, _evidence as E
from kinpole_ros.derivatives._evidence import evidence_of, derive, KNOWN
F=np.log(3*10**6.5)
def total(modes,samples):
    ev=evidence_of(modes,samples,float(len(samples)))
    n=len(samples); out=[]
    for c,(k) in enumerate((1,2)):
        num=KNOWN+n*k
        const=lgamma(num/2)-lgamma(KNOWN/2)+KNOWN/2*np.log(KNOWN)-n*k/2*np.log(np.pi)-num/2*np.log(num)
        e=ev.evidence[:,c]; m=e.max(axis=0)
        out.append(m+np.log(np.exp(e-m).sum(axis=0))+const-2*F*k)
    return np.array(out) # (2,S)
def run(y,noise,now,n=100,ahead=20,splits=(30,42,58,78)):
    # y (N,S)
    S=len(now)
    def win(a,b):  # samples from now+ahead-a .. relative newest: a newest offset exclusive
        rows=np.array(now)[None,:]+ahead-np.arange(b-1,a-1,-1)[:,None]
        x=(y[rows]-y[np.array(now)])/noise
        s=np.stack([x,x*0,x*0],axis=1); return np.ascontiguousarray(s)
    res=[];logp=[]
    w=win(0,n); m=M.modes_of(n); f=derive(m,M.stencils_of(n,(n-1)/2-ahead,1,4),w,float(n))
    res.append((f.mean[:,0],f.covariance[:,:,0])); logp.append(total(m,w)[0])
    for k in splits:
        wi,wo=win(0,k),win(k,n)
        mi=M.modes_of(k); f=derive(mi,M.stencils_of(k,(k-1)/2-ahead,1,4),wi,float(k))
        res.append((f.mean[:,0],f.covariance[:,:,0])); logp.append(total(mi,wi)[0]+total(M.modes_of(n-k),wo)[0]+np.log(.5/len(splits)))
    logp=np.array(logp); p=np.exp(logp-logp.max(0)); p/=p.sum(0)
    mean=sum(pi*r[0] for pi,r in zip(p,res))
    return res[0][0],mean,p
dt=.005; rng=np.random.default_rng(0)
t=np.arange(720)*dt
stopped=np.minimum(t,t[400]); begun=np.maximum(t-t[640],0)
y=(np.sin(6*stopped)+30*begun**2)[:,None]
rate=np.where(t<t[400],6*np.cos(6*t),60*begun)
noise=1e-4
yn=y[:,0]+noise*0.5*rng.normal(size=720)
now=list(range(110,690))
a,b,p=run(yn,noise*.5,now)
now=np.array(now); ea=a[1]*noise*.5/dt-rate[now]; eb=b[1]*noise*.5/dt-rate[now]
for nm,lo,hi in (('moving',110,380),('stop',425,620),('go',630,690)):
    s=(now>=lo)&(now<hi); print(nm,'whole %.4f split %.4f'%(np.sqrt((ea[s]**2).mean()),np.sqrt((eb[s]**2).mean())), 'p whole',p[0,s].mean().round(3))
