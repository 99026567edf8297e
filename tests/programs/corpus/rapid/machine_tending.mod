%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%
MODULE Tending
  ! loads a lathe, unloads to a conveyor
  CONST robtarget pWait:=<0|gripper|wobj0>;
  CONST robtarget pDoor:=<1|gripper|wobj0>;
  CONST robtarget pChuck:=<2|gripper|wobj0>;
  CONST robtarget pConveyor:=<3|gripper|table>;
  VAR bool bDone:=FALSE;
  VAR clock ck;

  PROC main()
    MoveJ pWait, v1500, z50, gripper;
    WHILE NOT bDone DO
      WaitDI diDoorOpen, 1\MaxTime:=30;
      Load;
      IF diPartOk=0 THEN
        Stop;
      ELSEIF diPartOk=1 AND nCount<100 THEN
        Unload;
      ELSE
        MoveJ pWait, v500, fine, gripper;
      ENDIF
    ENDWHILE
  ENDPROC

  PROC Load()
    MoveJ pDoor, v1000, z20, gripper;
    MoveL Offs(pChuck, 0, -120, 0), v500, z5, gripper;
    MoveL pChuck, v100, fine, gripper;
    SetDO doClamp, 1;
    WaitTime\InPos, 0.4;
    MoveL Offs (pChuck,0,-120,0), v500, z20, gripper;
  ENDPROC

  PROC Unload()
    MoveL RelTool(pConveyor,0,0,-80), v800, z10, gripper\WObj:=table;
    MoveL pConveyor, v150, fine, gripper\WObj:=table;
    PulseDO\PLength:=0.2, doNext;
  ENDPROC
ENDMODULE
