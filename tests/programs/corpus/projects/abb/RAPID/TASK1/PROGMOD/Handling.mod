MODULE Handling
  CONST num nOver:=60;
  LOCAL VAR triggdata trGrip;

  ! takes a part from any place
  PROC rPick(robtarget pAt,PERS tooldata tUsed,PERS wobjdata wUsed)
    TriggIO trGrip,20\DOp:=doGrip,1;
    MoveJ Offs(pAt,0,0,nOver),v1500,z20,tUsed\WObj:=wUsed;
    TriggL pAt,v200,trGrip,fine,tUsed\WObj:=wUsed;
    GripLoad part;
    MoveL RelTool(pAt,0,0,-nOver\Rz:=15),v800,z20,tUsed\WObj:=wUsed;
  ENDPROC

  PROC rDrop(robtarget pAt\switch Gentle)
    VAR speeddata vDown:=[200,500,5000,1000];
    IF Present(Gentle) vDown.v_tcp:=50;
    MoveJ Offs(pAt,0,0,nOver+20),v1500,z20,gripper\WObj:=fixture;
    MoveLDO pAt,vDown,fine,gripper\WObj:=fixture,doGrip,0;
  ENDPROC
ENDMODULE
